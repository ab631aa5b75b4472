# SPDX-License-Identifier: Apache-2.0
"""The differences of two policies in words."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from comarmor.errors import Origin
from comarmor.text import counted
from keymint.analysis.permission_changes import PermissionChange
from keymint.analysis.policy_diff import SubjectChanges


def as_text(differences: Sequence[SubjectChanges], place: Callable[[Origin | None], str]) -> Iterator[str]:
    """Yield the changes of each subject, one line each; a gain begins with ``+``, a loss with ``-``.

    Args:
        differences: the changes of each subject.
        place: returns a place as the user would type it.
    """
    for each in differences:
        yield subject_line(each)
        for change in each.changes:
            sign = "?" if change.unknown else "+" if change.gains else "-"
            where = f" ({place(change.where)})" if change.where else ""
            yield f"  {sign} {permission_text(change, str)}{object_text(change, str)}{where}"


def summary(differences: Sequence[SubjectChanges]) -> str:
    """Return on one line how many subjects gain, and how many lose."""
    if not differences:
        return "equivalent: no subject gains or loses anything"
    gaining = sum(any(change.gains and not change.unknown for change in each.changes) for each in differences)
    losing = sum(any(not change.gains and not change.unknown for change in each.changes) for each in differences)
    unknown = sum(any(change.unknown for change in each.changes) for each in differences)
    gains = f"{counted(gaining, 'subject')} {'gains' if gaining == 1 else 'gain'}"
    line = f"{gains}, {losing or 'none'} {'loses' if losing == 1 else 'lose'}"
    return line + (f"; not decided for {unknown}" if unknown else "")


def subject_line(each: SubjectChanges, code: Callable[[str], str] = str) -> str:
    """Return the subject of changes, and whether the profiles that apply to it are new or gone."""
    subject = code(each.subject)
    like = f"subjects like {code(each.like)}"
    if each.excluded:
        like += f" except {', '.join(map(code, each.excluded))}"
    name = (f"{like} (e.g. {subject})" if each.subject else like) if each.like else subject
    if each.before and each.after:
        return f"{name}:"
    which = "new" if each.after else "no profile applies any more"
    return f"{name} ({which}):" if each.changes else f"{name} ({which}), without any permission"


def permission_text(change: PermissionChange, code: Callable[[str], str]) -> str:
    """Return the permission of a change with a space behind it, or nothing if it has none."""
    return f"{code(change.permission)} " if change.permission else ""


def object_text(change: PermissionChange, code: Callable[[str], str]) -> str:
    """Return the objects of a change: a pattern, and an example where the pattern does not change as a whole."""
    pattern = code(change.pattern)
    if change.unknown:
        what = "gains" if change.gains else "loses"
        return f"perhaps {what} it on {pattern}: {change.unknown}" if change.permission else change.unknown
    if change.whole:
        return pattern if change.example == change.pattern else f"{pattern}, e.g. {code(change.example)}"
    return f"on part of {pattern}, e.g. {code(change.example)}"
