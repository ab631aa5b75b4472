"""What the rules of a policy say of the subjects that their profiles match by a pattern, ready to be asked."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass

from comarmor.errors import Origin
from comarmor.patterns.glob import Glob, literal, parse
from comarmor.patterns.relations import TooComplexError, disjoint
from comarmor.patterns.tokens import STAR
from comarmor.rules import Effect
from keymint.analysis.rule_lists import PermissionKey, permission_keys
from keymint.analysis.subject_patterns import EVERY, profile_subjects
from keymint.analysis.subject_templates import symbolic_patterns
from keymint.analysis.symbolic_search import SymbolicCondition, SymbolicEntry, namespace_name_pairs
from keymint.api import PolicyStructure

_Profiles = tuple[tuple[str, ...], ...]
_MOST_PIECES = 8
"""Patterns that nested profiles may have in common; of more, the inner profiles become conditions of their own."""


@dataclass(frozen=True, slots=True)
class ProfileReach:
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
    def conditions(self) -> tuple[SymbolicCondition, ...]:
        """What a subject that a pattern matches must be like besides."""
        return tuple(
            SymbolicCondition(
                some=tuple(SymbolicEntry(namespace_name_pairs(parse(expression)), (STAR,)) for expression in level)
            )
            for level in self.left
        )


@dataclass(frozen=True, slots=True)
class SymbolicRule:
    """An expression of a rule.

    Attributes:
        profiles: expressions of the profiles that the rule stands in, outermost first.
        reach: the subjects.
        object: pattern of symbolic words.
        where: the rule.
    """

    profiles: _Profiles
    reach: ProfileReach
    object: Glob
    where: Origin

    @property
    def said(self) -> tuple[_Profiles, Glob]:
        """What it says, wherever it stands."""
        return self.profiles, self.object

    def entry(self) -> SymbolicEntry:
        """Return it as part of a condition."""
        subjects = self.reach.exact or self.reach.subjects
        return SymbolicEntry(tuple(pair for one in subjects for pair in namespace_name_pairs(one)), self.object)


class SymbolicRules:
    """What the rules of a policy say of subjects that its profiles match by a pattern.

    Args:
        written: the policy as it is written.

    Attributes:
        singles: subjects that its profiles match each by itself, and no pattern of the book does: those that it names
            exactly, and those that two patterns have in common.
    """

    def __init__(self, written: PolicyStructure) -> None:
        self.singles: dict[str, None] = {}
        self._found: dict[tuple[PermissionKey, Effect], dict[tuple[_Profiles, Glob], SymbolicRule]] = defaultdict(dict)
        self._near: dict[tuple[PermissionKey, Effect], _ProfileIndex] = {}
        reaches: dict[_Profiles, ProfileReach] = {}
        for clause in written.clauses:
            if clause.profiles not in reaches:
                reaches[clause.profiles], singles = profile_reach(clause.profiles)
                self.singles |= dict.fromkeys(singles)
            subjects = reaches[clause.profiles]
            if not subjects.subjects:
                continue
            for key in permission_keys(clause.rule):
                for pattern in symbolic_patterns(clause, key):
                    spoken = SymbolicRule(clause.profiles, subjects, pattern, clause.rule.origin)
                    self._found[key, clause.rule.effect].setdefault(spoken.said, spoken)

    def all(self, key: PermissionKey, effect: Effect) -> dict[tuple[_Profiles, Glob], SymbolicRule]:
        """Return what rules of an effect say of a kind and permission without parts, by what they say."""
        return self._found.get((key, effect), {})

    def surely(self, key: PermissionKey, effect: Effect, subjects: Glob) -> tuple[SymbolicEntry, ...]:
        """Return what rules of an effect say that may be about some subjects; where that is too complex, less."""
        return tuple(one.entry() for one in self._about(key, effect, subjects) if one.reach.exact)

    def perhaps(self, key: PermissionKey, effect: Effect, subjects: Glob) -> tuple[SymbolicEntry, ...]:
        """Return what rules of an effect say that may be about some subjects; where that is too complex, more."""
        return tuple(one.entry() for one in self._about(key, effect, subjects))

    def _about(self, key: PermissionKey, effect: Effect, subjects: Glob) -> Iterator[SymbolicRule]:
        if (key, effect) not in self._near:
            self._near[key, effect] = _ProfileIndex(self.all(key, effect))
        yield from self._near[key, effect].of(subjects)


class _ProfileIndex:
    """What rules say, by the profiles that they stand in."""

    def __init__(self, found: dict[tuple[_Profiles, Glob], SymbolicRule]) -> None:
        self._by_profiles: dict[_Profiles, list[SymbolicRule]] = defaultdict(list)
        self._by_head: dict[str, dict[_Profiles, None]] = defaultdict(dict)
        for spoken in found.values():
            self._by_profiles[spoken.profiles].append(spoken)
            for one in spoken.reach.subjects:
                self._by_head[_head(one)][spoken.profiles] = None
        self._known: dict[Glob, tuple[SymbolicRule, ...]] = {}

    def of(self, subjects: Glob) -> tuple[SymbolicRule, ...]:
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


def profile_reach(profiles: _Profiles) -> tuple[ProfileReach, tuple[str, ...]]:
    """Return the subjects that nested profiles match by a pattern, and those that they match each by itself."""
    exact: tuple[Glob, ...] = ()
    for depth in range(len(profiles), 0, -1):
        try:
            found = profile_subjects(profiles[:depth])
        except TooComplexError:
            continue
        if depth == len(profiles):
            exact = found
        if depth > 1 and len(found) > max(_MOST_PIECES, *map(len, profiles)):
            continue
        singles = tuple(name for one in found if (name := literal(one)) is not None)
        return ProfileReach(tuple(one for one in found if literal(one) is None), profiles[depth:], exact), singles
    return ProfileReach((EVERY,), profiles, ()), ()


def _head(pattern: Glob) -> str:
    return pattern[0] if pattern and isinstance(pattern[0], str) else ""
