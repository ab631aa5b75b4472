# SPDX-License-Identifier: Apache-2.0
"""The differences of two policies in words, and as JSON, which ``docs/json.md`` describes."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from comarmor.text import lazy_regex, quantity
from keymint.analysis.permission_changes import PermissionChange
from keymint.analysis.policy_diff import SubjectChanges
from keymint.errors import Origin, Spot
from keymint.output.json import Typed, line_json
from keymint.output.report import members


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
            only = f" [{change.build_type} only]" if change.build_type else ""
            yield f"  {sign} {permission_text(change, str)}{object_text(change, str)}{where}{only}"


def summary(differences: Sequence[SubjectChanges]) -> str:
    """Return on one line how many subjects gain, and how many lose."""
    if not differences:
        return "equivalent: no subject gains or loses anything"
    gaining = sum(any(change.gains and not change.unknown for change in each.changes) for each in differences)
    losing = sum(any(not change.gains and not change.unknown for change in each.changes) for each in differences)
    unknown = sum(any(change.unknown for change in each.changes) for each in differences)
    gains = f"{quantity(gaining, 'subject')} {'gains' if gaining == 1 else 'gain'}"
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
    which = "new" if each.after else "nothing is left"
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


def markdown(
    differences: Sequence[SubjectChanges],
    place: Callable[[Origin | None], str],
    library: Callable[[str], str | None],
    titles: tuple[str, str],
) -> Iterator[str]:
    """Yield the lines of a comment on a code review.

    For a node that is new or gone, the rules of the library take one line for each file that the policy includes.

    Args:
        differences: the changes of each subject.
        place: returns a place as the user would type it.
        library: returns the name of a file in the library; None of any other file.
        titles: names of the older and of the newer policy.
    """
    yield f"### Access control: {_code(titles[0])} → {_code(titles[1])}"
    yield ""
    if not differences:
        yield "**Equivalent**: no subject gains or loses anything."
        return
    yield f"{summary(differences)}."
    for each in differences:
        yield ""
        yield f"#### {subject_line(each, _code).rstrip(':')}"
        own, folded = _folded(each, library)
        if own:
            yield ""
            yield "| | permission | objects | rule |"
            yield "|---|---|---|---|"
        for change in own:
            sign = ("perhaps " if change.unknown else "") + ("gains" if change.gains else "loses")
            objects = object_text(change, _code)
            where = _code(place(change.where)) if change.where else ""
            yield f"| {sign} | {permission_text(change, _code).rstrip()} | {objects} | {where} |"
        if folded:
            yield ""
        for name, number in folded.items():
            rules = f"the {number} rules" if number > 1 else "the rule"
            yield f"… and {rules} of {_code(name)} (library)"


def _folded(
    each: SubjectChanges, library: Callable[[str], str | None]
) -> tuple[list[PermissionChange], dict[str, int]]:
    """Return the changes to list, and for each file of the library the number of rules behind the other changes."""
    if each.before and each.after:
        return [*each.changes], {}
    own: list[PermissionChange] = []
    rules: dict[str, set[Spot]] = {}
    for change in each.changes:
        where = change.where
        if where is None or change.unknown or library(where.file) is None:
            own.append(change)
            continue
        names = [name for place in (where, *where.chain) if (name := library(place.file))]
        rules.setdefault(names[-1], set()).add(where.spot)
    return own, {name: len(spots) for name, spots in rules.items()}


def _code(text: str) -> str:
    """Return a code span (CommonMark 0.31.2, 6.1) that may stand in a table; no text ends it."""
    fence = "`" * (max(map(len, re.findall("`+", text)), default=0) + 1)
    blank = " " * ("`" in (text[:1], text[-1:]))
    # A pipe gets backslashes of which the last escapes it, however many there are.
    return _PIPE.sub(
        lambda match: match[1] + "\\" * (1 + len(match[1]) % 2) + "|", f"{fence}{blank}{text}{blank}{fence}"
    )


_PIPE = lazy_regex(r"(\\*)\|")


def differences_json(differences: Sequence[SubjectChanges], typed: Typed) -> list[dict[str, Any]]:
    """Return the differences of two policies as JSON data."""
    return [
        {
            "subject": each.subject or None,
            "stands_for": each.like or None,
            "except": [*each.excluded],
            "applies": {"before": each.before, "after": each.after},
            "changes": [
                {
                    "change": "gains" if change.gains else "loses",
                    **members(change, "kind", "permission"),
                    "pattern": change.pattern,
                    **members(change, "whole", "example"),
                    "rule": line_json(change.where, typed),
                    "unknown": change.unknown or None,
                    "build_type": change.build_type or None,
                }
                for change in each.changes
            ],
        }
        for each in differences
    ]
