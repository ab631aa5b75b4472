"""Names that are nearly alike, where the other one would fit: what a slip of the pen leaves behind."""

from __future__ import annotations

import difflib
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence

from comarmor.errors import Diagnostic, Origin, Severity
from comarmor.patterns.edit_distance import NameTrie
from comarmor.patterns.glob import Glob, literal, parse
from comarmor.patterns.pattern_index import PatternIndex
from comarmor.patterns.steps import StepLimitError, spend, step_limit
from comarmor.rules import Effect
from keymint.analysis.attachments import AttachmentIndex
from keymint.analysis.rule_lists import RAW
from keymint.api import PolicyStructure
from keymint.ir import Rule

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
_ALIKE = 0.8
"""How much two names must be alike, as :meth:`difflib.SequenceMatcher.ratio` says."""
_FEW = 64
"""Names of the same words that are looked at."""
_STEPS = 2_000
"""Steps that the search for a name may take."""
_DIGITS = re.compile(r"\d+")


def similar_names(subjects: Mapping[str, tuple[Rule, ...]], attachments: AttachmentIndex) -> Iterator[Diagnostic]:
    """Yield names that nobody is at the other end of, where a name that is nearly the same has nobody at this end.

    Args:
        subjects: the rules of each subject that a policy names.
        attachments: where their expressions are written.
    """
    exact, wild = _allowed(subjects)

    wilds = {permission: PatternIndex((pattern, None) for pattern in patterns) for permission, patterns in wild.items()}

    def alone(permission: str, name: str) -> bool:
        other = _SIDES[permission][1]
        matching = wilds[other].meeting((name,)) if other in wilds else ()
        return name not in exact[other] and not any(True for _ in matching)

    told: set[frozenset[str]] = set()
    given_up: list[str] = []
    for permission, (kind, other) in _SIDES.items():
        candidates = _Candidates(name for name in exact[other] if alone(other, name))
        for name, (subject, rule) in exact[permission].items():
            near = _given(candidates, name, _MOST_EDITS, given_up) if alone(permission, name) else None
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
    yield from _unknown(given_up)


def similar_subjects(written: PolicyStructure) -> Iterator[Diagnostic]:
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
    given_up: list[str] = []
    often = _Candidates(name for name, places in named.items() if len(places) > 1)
    for name, places in named.items():
        near = _given(often, name, 1, given_up) if len(places) == 1 else None
        if near:
            yield Diagnostic(
                "name-similar",
                Severity.WARNING,
                f"one profile is about the subject {name!r}, and {len(named[near])} are about {near!r}",
                next(iter(places.values())),
                f"did you mean {near!r}?",
            )
    yield from _unknown(given_up)


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


def _given(candidates: _Candidates, name: str, most: int, given_up: list[str]) -> str | None:
    """Return the nearest of some candidates; note the name where that takes too many steps."""
    try:
        return candidates.nearest(name, most)
    except StepLimitError:
        given_up.append(name)
        return None


def _unknown(given_up: Sequence[str]) -> Iterator[Diagnostic]:
    """Yield a note on names that were not held against all others."""
    if given_up:
        yield Diagnostic(
            "lint-unknown",
            Severity.NOTE,
            f"it was not found out which names are nearly like {given_up[0]!r}"
            + (f" and {len(given_up) - 1:,} others" if len(given_up) > 1 else "")
            + f": there are too many within {_STEPS:,} steps",
            None,
            "look at these names yourself, or lint parts of the policy",
        )


class _Candidates:
    """Names that another one may have been meant to be.

    Numbers are left out of the search: names that differ in numbers only are no slips.
    """

    def __init__(self, names: Iterable[str]) -> None:
        self._by_words: dict[str, list[str]] = defaultdict(list)
        self._by_numbers: dict[tuple[str, tuple[str, ...]], list[str]] = defaultdict(list)
        for name in names:
            if len(name) >= _SHORTEST:
                words = _DIGITS.sub("", name)
                self._by_words[words].append(name)
                self._by_numbers[words, tuple(_DIGITS.findall(name))].append(name)
        self._words = NameTrie(self._by_words)

    def nearest(self, name: str, most: int) -> str | None:
        """Return the name that is most alike of those that differ by a slip of the pen, and not in numbers only.

        Raises:
            EffortError: there are too many names like it.
        """
        if len(name) < _SHORTEST:
            return None
        words = _DIGITS.sub("", name)
        best: tuple[float, str] | None = None
        with step_limit(_STEPS):
            for other in self._words.near(words, most):
                for near in self._likely(name, other) if other != words else ():
                    spend(len(name))
                    ratio = difflib.SequenceMatcher(None, name, near).ratio()
                    if ratio >= _ALIKE and _edits(name, near) <= most and (best is None or (ratio, near) > best):
                        best = (ratio, near)
        return best[1] if best else None

    def _likely(self, name: str, words: str) -> Sequence[str]:
        """Return the names of some words that have the numbers of another name, or else a few."""
        same = self._by_numbers.get((words, tuple(_DIGITS.findall(name))), ())
        return same or self._by_words[words][:_FEW]


def _edits(one: str, other: str) -> int:
    steps = difflib.SequenceMatcher(None, one, other, autojunk=False).get_opcodes()
    return sum(max(high - low, high2 - low2) for tag, low, high, low2, high2 in steps if tag != "equal")
