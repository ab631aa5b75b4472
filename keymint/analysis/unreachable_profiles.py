"""Find profiles that never apply, attachments without a subject, and unused tunables."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from comarmor.errors import Diagnostic
from comarmor.patterns.glob import parse
from comarmor.patterns.relations import TooComplexError
from comarmor.text import did_you_mean, first_few
from keymint.analysis.findings import warning
from keymint.analysis.subject_patterns import can_exist, profile_subjects
from keymint.api import PolicyStructure


def unreachable_profiles(written: PolicyStructure) -> Iterator[Diagnostic]:
    """Yield profiles that never apply, attachments that no subject matches, and unused tunables."""
    for name, where in written.unused:
        yield warning("tunable-unused", f"the tunable @{{{name}}} is never used", where, "remove it")
    for profile in written.profiles:
        applies = False
        for expression, where in profile.attachments:
            if not can_exist(parse(expression)):
                message = f"no subject name matches the attachment {expression!r} of profile {profile.name!r}"
                yield warning("subject-never", message, where, "subject names look like /robot1/talker")
                continue
            try:
                reachable = any(can_exist(one) for one in profile_subjects((*profile.around, (expression,))))
            except TooComplexError:
                reachable = True
            applies = applies or reachable
            if not reachable and len(profile.attachments) > 1:
                message = (
                    f"profile {profile.name!r} never applies to {expression!r}: "
                    f"the profiles around it apply only to {quoted_list(profile.around[-1])}"
                )
                yield warning("profile-never", message, where, _advice(expression, profile.around[-1]))
        if not applies and profile.around and len(profile.attachments) == 1:
            ((expression, where),) = profile.attachments
            message = (
                f"profile {profile.name!r} never applies: no subject matches both its attachment "
                f"{expression!r} and the profiles around it ({quoted_list(profile.around[-1])})"
            )
            yield warning("profile-never", message, where, _advice(expression, profile.around[-1]))


def _advice(attachment: str, around: Sequence[str]) -> str:
    return did_you_mean(attachment, around, "fix the attachment, or move the profile out", similarity=0.8)


def quoted_list(expressions: Sequence[str]) -> str:
    """Return the first expressions for a message."""
    return first_few([repr(each) for each in expressions], 3)
