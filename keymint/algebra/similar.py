"""Names that are nearly alike, where the other one would fit: what a slip of the pen leaves behind."""

from __future__ import annotations

import difflib
import re
from collections import defaultdict
from collections.abc import Iterator, Mapping

from keymint.algebra.attachments import Attachments
from keymint.algebra.lists import RAW
from keymint.api import Structure
from keymint.errors import Diagnostic, Origin, Severity
from keymint.ir import Effect, Rule
from keymint.keymake.algebra import matches
from keymint.keymake.glob import Glob, literal, parse

_SIDES = {
    "publish": (RAW, "subscribe"),
    "subscribe": (RAW, "publish"),
    "ros_publish": ("ros_topic", "ros_subscribe"),
    "ros_subscribe": ("ros_topic", "ros_publish"),
    "ros_call": ("ros_service", "ros_execute"),
    "ros_execute": ("ros_service", "ros_call"),
    "ros_request": ("ros_action", "ros_operate"),
    "ros_operate": ("ros_action", "ros_request"),
}
"""The kind of a permission, and the permission of whoever is at the other end."""
_MOST_EDITS = 2
_SHORTEST = 4
_DIGITS = re.compile(r"\d+")


def similar_names(subjects: Mapping[str, tuple[Rule, ...]], attachments: Attachments) -> Iterator[Diagnostic]:
    """Yield names that nobody is at the other end of, where a name that is nearly the same has nobody at this end.

    Args:
        subjects: the rules of each subject that a policy names.
        attachments: where their expressions are written.
    """
    exact, wild = _allowed(subjects)

    def alone(permission: str, name: str) -> bool:
        other = _SIDES[permission][1]
        return name not in exact[other] and not any(matches(pattern, name) for pattern in wild[other])

    told: set[frozenset[str]] = set()
    for permission, (kind, other) in _SIDES.items():
        candidates = [name for name in exact[other] if alone(other, name)]
        for name, (subject, rule) in exact[permission].items():
            near = _nearest(name, candidates) if alone(permission, name) else None
            if near and frozenset((name, near)) not in told:
                told.add(frozenset((name, near)))
                whose, theirs = exact[other][near]
                there = attachments.of(theirs, whose)[near].where
                yield Diagnostic(
                    "name-similar",
                    Severity.WARNING,
                    f"{subject} may {_plain(permission)} the {kind} {name!r} and nobody may {_plain(other)} it, "
                    f"but {whose} may {_plain(other)} {near!r} ({there.alone()})",
                    attachments.of(rule, subject)[name].where,
                    f"did you mean {near!r}?",
                    subject,
                )


def similar_subjects(written: Structure) -> Iterator[Diagnostic]:
    """Yield subjects that one profile names, where several name another one that differs in a single character.

    Args:
        written: the policy.
    """
    named: dict[str, dict[Origin, Origin]] = defaultdict(dict)
    for profile in written.profiles:
        for expression, where in profile.attachments:
            name = literal(parse(expression))
            if name is not None:
                named[name][profile.where] = where
    often = [name for name, places in named.items() if len(places) > 1]
    for name, places in named.items():
        near = _nearest(name, often, most=1) if len(places) == 1 else None
        if near:
            yield Diagnostic(
                "name-similar",
                Severity.WARNING,
                f"one profile is about the subject {name!r}, and {len(named[near])} are about {near!r}",
                next(iter(places.values())),
                f"did you mean {near!r}?",
            )


def _allowed(
    subjects: Mapping[str, tuple[Rule, ...]],
) -> tuple[dict[str, dict[str, tuple[str, Rule]]], dict[str, dict[Glob, None]]]:
    """Return, by permission, the names that are allowed exactly, with who and by which rule, and the patterns."""
    exact: dict[str, dict[str, tuple[str, Rule]]] = defaultdict(dict)
    wild: dict[str, dict[Glob, None]] = defaultdict(dict)
    for subject, rules in subjects.items():
        for rule in rules:
            if rule.effect is not Effect.ALLOW:
                continue
            for expression in rule.expressions:
                pattern = parse(expression)
                name = literal(pattern)
                for permission in rule.permissions:
                    if name is None:
                        wild[permission][pattern] = None
                    else:
                        exact[permission].setdefault(name, (subject, rule))
    return exact, wild


def _plain(permission: str) -> str:
    plain = permission.removeprefix("ros_")
    return f"{plain} to" if plain == "subscribe" else plain


def _nearest(name: str, candidates: list[str], most: int = _MOST_EDITS) -> str | None:
    """Return a name that differs by a slip of the pen, and not in numbers only."""
    for near in difflib.get_close_matches(name, candidates, n=3, cutoff=0.8):
        if near == name or _DIGITS.sub("", near) == _DIGITS.sub("", name):
            continue
        if min(len(near), len(name)) >= _SHORTEST and _edits(name, near) <= most:
            return near
    return None


def _edits(one: str, other: str) -> int:
    steps = difflib.SequenceMatcher(None, one, other, autojunk=False).get_opcodes()
    return sum(max(high - low, high2 - low2) for tag, low, high, low2, high2 in steps if tag != "equal")
