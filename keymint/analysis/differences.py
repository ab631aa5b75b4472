"""What changed between two policies, as text, as Markdown for a code review, and as data."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

from comarmor.errors import Origin, Spot
from comarmor.text import counted
from keymint.analysis.policy_diff import SubjectChanges
from keymint.analysis.rule_diff import PermissionChange

Typed = Callable[[Origin | None], str]


def as_text(found: Sequence[SubjectChanges], place: Typed) -> Iterator[str]:
    """Yield the lines that tell what changed; a gain begins with ``+``, a loss with ``-``.

    Args:
        found: what changed.
        place: returns a place as the user would type it.
    """
    for each in found:
        yield _subject(each)
        for change in each.changes:
            sign = "?" if change.unknown else "+" if change.gains else "-"
            where = f" ({place(change.where)})" if change.where else ""
            yield f"  {sign} {_held(change, str)}{_objects(change, str)}{where}"


def as_markdown(
    found: Sequence[SubjectChanges], place: Typed, library: Callable[[str], str | None], titles: tuple[str, str]
) -> Iterator[str]:
    """Yield the lines of a comment on a code review.

    Of a node that comes or goes, what the library allows is one line for each file that the policy includes.

    Args:
        found: what changed.
        place: returns a place as the user would type it.
        library: returns the name of a file in the library; None of any other file.
        titles: names of the older and of the newer policy.
    """
    yield f"### Access control: {_code(titles[0])} → {_code(titles[1])}"
    yield ""
    if not found:
        yield "**Equivalent**: no subject gains or loses anything."
        return
    yield f"{summary(found)}."
    for each in found:
        yield ""
        yield f"#### {_subject(each, _code).rstrip(':')}"
        own, folded = _folded(each, library)
        if own:
            yield ""
            yield "| | permission | objects | rule |"
            yield "|---|---|---|---|"
        for change in own:
            sign = _verb(change)
            objects = _objects(change, _code)
            where = _code(place(change.where)) if change.where else ""
            yield f"| {sign} | {_held(change, _code).rstrip()} | {objects} | {where} |"
        for at, (name, number) in enumerate(folded.items()):
            if at == 0:
                yield ""
            rules = f"the {number} rules" if number > 1 else "the rule"
            yield f"… and {rules} of {_code(name)} (library)"


def as_data(
    found: Sequence[SubjectChanges], place: Callable[[Origin | None], dict[str, Any] | None]
) -> list[dict[str, Any]]:
    """Return what changed as what JSON can hold."""
    return [
        {
            "subject": each.subject or None,
            "stands_for": each.like or None,
            "applies": {"before": each.before, "after": each.after},
            "changes": [
                {
                    "change": "gains" if change.gains else "loses",
                    "kind": change.kind or None,
                    "permission": change.permission or None,
                    "pattern": change.pattern,
                    "whole": change.whole,
                    "example": change.example or None,
                    "rule": place(change.where),
                    "unknown": change.unknown or None,
                }
                for change in each.changes
            ],
        }
        for each in found
    ]


def summary(found: Sequence[SubjectChanges]) -> str:
    """Return on one line how many subjects gain, and how many lose."""
    if not found:
        return "equivalent: no subject gains or loses anything"
    gaining = sum(any(change.gains and not change.unknown for change in each.changes) for each in found)
    losing = sum(any(not change.gains and not change.unknown for change in each.changes) for each in found)
    unknown = sum(any(change.unknown for change in each.changes) for each in found)
    gains = f"{counted(gaining, 'subject')} {'gains' if gaining == 1 else 'gain'}"
    line = f"{gains}, {losing or 'none'} {'loses' if losing == 1 else 'lose'}"
    return line + (f"; not decided for {unknown}" if unknown else "")


def _subject(each: SubjectChanges, code: Callable[[str], str] = str) -> str:
    subject = code(each.subject)
    like = f"subjects like {code(each.like)}"
    name = (f"{like} (e.g. {subject})" if each.subject else like) if each.like else subject
    if each.before and each.after:
        return f"{name}:"
    which = "new" if each.after else "no profile applies any more"
    return f"{name} ({which}):" if each.changes else f"{name} ({which}), without any permission"


def _folded(
    each: SubjectChanges, library: Callable[[str], str | None]
) -> tuple[list[PermissionChange], dict[str, int]]:
    """Return the changes to list, and how many rules of which file of the library the others are by."""
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


def _verb(change: PermissionChange) -> str:
    verb = "gains" if change.gains else "loses"
    return f"perhaps {verb}" if change.unknown else verb


def _held(change: PermissionChange, code: Callable[[str], str]) -> str:
    return f"{code(change.permission)} " if change.permission else ""


def _objects(change: PermissionChange, code: Callable[[str], str]) -> str:
    pattern = code(change.pattern)
    if change.unknown:
        what = "gains" if change.gains else "loses"
        return f"perhaps {what} it on {pattern}: {change.unknown}" if change.permission else change.unknown
    if change.whole:
        return pattern if change.example == change.pattern else f"{pattern}, e.g. {code(change.example)}"
    return f"on part of {pattern}, e.g. {code(change.example)}"


def _code(text: str) -> str:
    fence = "``" if "`" in text else "`"
    return f"{fence}{text}{fence}".replace("|", "\\|")
