"""What the rules of a policy say of the subjects that their profiles match by a pattern, ready to be asked."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass

from comarmor.errors import Origin
from comarmor.patterns.glob import STAR, Glob, literal, parse
from comarmor.patterns.relations import TooComplexError, disjoint
from comarmor.rules import Effect
from keymint.analysis.lists import Key, keys
from keymint.analysis.subjects import EVERY, reached
from keymint.analysis.symbolic import Condition, Entry, pairs
from keymint.analysis.templates import symbolic
from keymint.api import Structure

_Profiles = tuple[tuple[str, ...], ...]
_MOST_PIECES = 8
"""Patterns that nested profiles may have in common; of more, the inner profiles become conditions of their own."""


@dataclass(frozen=True, slots=True)
class Reach:
    """The subjects that nested profiles match by a pattern.

    Attributes:
        subjects: patterns that together match them.
        left: expressions of the profiles that are not yet in the patterns, which match too much then.
        exact: patterns that match no other subjects, though they are many; empty if they are too many.
    """

    subjects: tuple[Glob, ...]
    left: _Profiles
    exact: tuple[Glob, ...]

    @property
    def conditions(self) -> tuple[Condition, ...]:
        """What a subject that a pattern matches must be like besides."""
        return tuple(
            Condition(some=tuple(Entry(pairs(parse(expression)), (STAR,)) for expression in level))
            for level in self.left
        )


@dataclass(frozen=True, slots=True)
class Spoken:
    """An expression of a rule.

    Attributes:
        profiles: expressions of the profiles that the rule stands in, outermost first.
        reach: the subjects.
        object: pattern of symbolic words.
        where: the rule.
    """

    profiles: _Profiles
    reach: Reach
    object: Glob
    where: Origin

    @property
    def said(self) -> tuple[_Profiles, Glob]:
        """What it says, wherever it stands."""
        return self.profiles, self.object

    def entry(self) -> Entry:
        """Return it as part of a condition."""
        subjects = self.reach.exact or self.reach.subjects
        return Entry(tuple(pair for one in subjects for pair in pairs(one)), self.object)


class Book:
    """What the rules of a policy say of subjects that its profiles match by a pattern.

    Args:
        written: the policy as it is written.

    Attributes:
        singles: subjects that its profiles match each by itself, and no pattern of the book does: those that it names
            exactly, and those that two patterns have in common.
    """

    def __init__(self, written: Structure) -> None:
        self.singles: dict[str, None] = {}
        self._found: dict[tuple[Key, Effect], dict[tuple[_Profiles, Glob], Spoken]] = defaultdict(dict)
        self._near: dict[tuple[Key, Effect], _Near] = {}
        reaches: dict[_Profiles, Reach] = {}
        for clause in written.clauses:
            if clause.profiles not in reaches:
                reaches[clause.profiles], singles = reach(clause.profiles)
                self.singles |= dict.fromkeys(singles)
            subjects = reaches[clause.profiles]
            if not subjects.subjects:
                continue
            for key in keys(clause.rule):
                for pattern in symbolic(clause, key):
                    spoken = Spoken(clause.profiles, subjects, pattern, clause.rule.origin)
                    self._found[key, clause.rule.effect].setdefault(spoken.said, spoken)

    def all(self, key: Key, effect: Effect) -> dict[tuple[_Profiles, Glob], Spoken]:
        """Return what rules of an effect say of a kind and permission without parts, by what they say."""
        return self._found.get((key, effect), {})

    def surely(self, key: Key, effect: Effect, subjects: Glob) -> tuple[Entry, ...]:
        """Return what rules of an effect say that may be about some subjects; where that is too complex, less."""
        return tuple(one.entry() for one in self._about(key, effect, subjects) if one.reach.exact)

    def perhaps(self, key: Key, effect: Effect, subjects: Glob) -> tuple[Entry, ...]:
        """Return what rules of an effect say that may be about some subjects; where that is too complex, more."""
        return tuple(one.entry() for one in self._about(key, effect, subjects))

    def _about(self, key: Key, effect: Effect, subjects: Glob) -> Iterator[Spoken]:
        if (key, effect) not in self._near:
            self._near[key, effect] = _Near(self.all(key, effect))
        yield from self._near[key, effect].of(subjects)


class _Near:
    """What rules say, by the profiles that they stand in."""

    def __init__(self, found: dict[tuple[_Profiles, Glob], Spoken]) -> None:
        self._by_profiles: dict[_Profiles, list[Spoken]] = defaultdict(list)
        self._by_head: dict[str, dict[_Profiles, None]] = defaultdict(dict)
        for spoken in found.values():
            self._by_profiles[spoken.profiles].append(spoken)
            for one in spoken.reach.subjects:
                self._by_head[_head(one)][spoken.profiles] = None
        self._known: dict[Glob, tuple[Spoken, ...]] = {}

    def of(self, subjects: Glob) -> tuple[Spoken, ...]:
        """Return the description of subjects that a pattern matches."""
        if subjects not in self._known:
            head = _head(subjects)
            near = dict.fromkeys(
                profiles
                for text, found in self._by_head.items()
                if text.startswith(head) or head.startswith(text)
                for profiles in found
            )
            self._known[subjects] = tuple(
                spoken
                for profiles in near
                if any(not disjoint(one, subjects) for one in self._by_profiles[profiles][0].reach.subjects)
                for spoken in self._by_profiles[profiles]
            )
        return self._known[subjects]


def reach(profiles: _Profiles) -> tuple[Reach, tuple[str, ...]]:
    """Return the subjects that nested profiles match by a pattern, and those that they match each by itself."""
    exact: tuple[Glob, ...] = ()
    for depth in range(len(profiles), 0, -1):
        try:
            found = reached(profiles[:depth])
        except TooComplexError:
            continue
        if depth == len(profiles):
            exact = found
        if depth > 1 and len(found) > max(_MOST_PIECES, *map(len, profiles)):
            continue
        singles = tuple(name for one in found if (name := literal(one)) is not None)
        return Reach(tuple(one for one in found if literal(one) is None), profiles[depth:], exact), singles
    return Reach((EVERY,), profiles, ()), ()


def _head(pattern: Glob) -> str:
    return pattern[0] if pattern and isinstance(pattern[0], str) else ""
