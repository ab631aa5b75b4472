"""What can be seen of profiles and tunables as they are written: those that are never of use."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from comarmor.errors import Diagnostic, Origin, Severity
from comarmor.patterns.glob import parse
from comarmor.patterns.relations import TooComplexError
from comarmor.text import did_you_mean, first_few
from keymint.analysis.subject_patterns import can_exist, profile_subjects
from keymint.api import PolicyStructure


def unreachable_profiles(found: PolicyStructure) -> Iterator[Diagnostic]:
    """Yield profiles that never apply, attachments that no subject matches, and tunables that nothing uses."""
    for name, where in found.unused:
        yield _said("tunable-unused", f"nothing uses the tunable @{{{name}}}", where, "remove it")
    for profile in found.profiles:
        possible = False
        for expression, where in profile.attachments:
            if not can_exist(parse(expression)):
                message = f"no subject can be named as the attachment {expression!r} of profile {profile.name!r} says"
                yield _said("subject-never", message, where, "a subject is named like /robot1/talker")
                continue
            try:
                inside = [one for one in profile_subjects((*profile.around, (expression,))) if can_exist(one)]
            except TooComplexError:
                possible = True
                continue
            possible = possible or bool(inside)
            if not inside and len(profile.attachments) > 1:
                message = (
                    f"profile {profile.name!r} never applies to {expression!r}: "
                    f"the profiles around it apply to {quoted(profile.around[-1])} only"
                )
                yield _said("profile-never", message, where, _mend(expression, profile.around[-1]))
        if not possible and profile.around and len(profile.attachments) == 1:
            message = (
                f"profile {profile.name!r} never applies: no subject matches both its attachment "
                f"{profile.attachments[0][0]!r} and the profiles around it ({quoted(profile.around[-1])})"
            )
            mend = _mend(profile.attachments[0][0], profile.around[-1])
            yield _said("profile-never", message, profile.attachments[0][1], mend)


def _mend(attachment: str, around: Sequence[str]) -> str:
    return did_you_mean(attachment, around, "fix the attachment, or move the profile out", similarity=0.8)


def quoted(expressions: Sequence[str]) -> str:
    """Return expressions for a message, the first of many."""
    return first_few([repr(each) for each in expressions], 3)


def _said(code: str, message: str, where: Origin, help_: str) -> Diagnostic:
    return Diagnostic(code, Severity.WARNING, message, where, help_)
