# SPDX-License-Identifier: Apache-2.0
"""Rules of a policy for patterns of subjects, as input of the symbolic search."""

from __future__ import annotations

from collections import defaultdict
from functools import cache

from comarmor.errors import Origin
from comarmor.patterns.glob import Glob, literal, parse
from comarmor.patterns.pattern_index import PatternIndex
from comarmor.patterns.relations import TooComplexError
from comarmor.patterns.tokens import STAR
from comarmor.rules import Effect
from comarmor.values import dataclass
from keymint.analysis.rule_lists import PermissionKey, permission_keys
from keymint.analysis.subject_patterns import EVERY, SubjectClass, profile_chain, profile_subjects
from keymint.analysis.subject_templates import fit_pattern, symbolic_patterns
from keymint.analysis.symbolic_search import SymbolicCondition, SymbolicEntry, namespace_name_pairs
from keymint.api import PolicyStructure

_Profiles = tuple[tuple[str, ...], ...]
_MOST_PIECES = 8
"""Maximum number of intersections of nested profiles; beyond it the inner profiles become separate conditions."""


@dataclass(frozen=True, slots=True)
class ProfileReach:
    """The subjects that nested profiles match by patterns.

    Attributes:
        subjects: patterns that together match at least them.
        left: expressions of the profiles that ``subjects`` ignores.
        exact: patterns that match exactly them; may be many, and empty if they are too many.
    """

    subjects: tuple[Glob, ...]
    left: _Profiles
    exact: tuple[Glob, ...]

    @property
    def conditions(self) -> tuple[SymbolicCondition, ...]:
        """Conditions of the profiles that ``subjects`` ignores."""
        return tuple(
            SymbolicCondition(
                tuple(SymbolicEntry(namespace_name_pairs(parse(each)), (STAR,)) for each in level), some=True
            )
            for level in self.left
        )


@dataclass(frozen=True, slots=True)
class SymbolicRule:
    """An expression of a rule.

    Attributes:
        profiles: expressions of the profiles around the rule, outermost first.
        reach: its subjects.
        object: pattern of symbolic words.
        where: the rule.
    """

    profiles: _Profiles
    reach: ProfileReach
    object: Glob
    where: Origin

    @property
    def content(self) -> tuple[_Profiles, Glob]:
        """The rule without its place."""
        return self.profiles, self.object

    def may_meet(self, objects: Glob, area: SubjectClass) -> bool:
        """Return False if the rule is surely not about some objects, for any of some subjects.

        Args:
            objects: pattern of symbolic words.
            area: the subjects.
        """
        halves = (each for piece in area.overlaps(self.reach.subjects) for each in namespace_name_pairs(piece))
        return any(fit_pattern(self.object, objects, *each, wide=True).pieces for each in halves)

    def entry(self) -> SymbolicEntry:
        """Return the rule as an entry of a condition."""
        subjects = self.reach.exact or self.reach.subjects
        return SymbolicEntry(tuple(pair for one in subjects for pair in namespace_name_pairs(one)), self.object)


class SymbolicRules:
    """The rules of a policy for subjects that its profiles match by patterns.

    Args:
        written: structure of the policy.

    Attributes:
        singles: subjects that profiles match exactly: those that the policy names, and single overlaps of patterns.
        profiles: attachments of each profile and of those around it, by patterns of its subjects.
    """

    def __init__(self, written: PolicyStructure) -> None:
        self.singles: dict[str, None] = {}
        self._by_key: dict[tuple[PermissionKey, Effect], dict[tuple[_Profiles, Glob], SymbolicRule]] = defaultdict(dict)
        self._index = cache(self._indexed)
        self.applying = cache(self._find_applying)
        chains = (*(clause.profiles for clause in written.clauses), *map(profile_chain, written.profiles))
        reaches: dict[_Profiles, ProfileReach] = {}
        for profiles in dict.fromkeys(chains):
            reaches[profiles], singles = profile_reach(profiles)
            self.singles |= dict.fromkeys(singles)
        self.profiles = PatternIndex((one, profiles) for profiles, reach in reaches.items() for one in reach.subjects)
        for clause in written.clauses:
            subjects = reaches[clause.profiles]
            if not subjects.subjects:
                continue
            for key in permission_keys(clause.rule):
                for pattern in symbolic_patterns(clause, key):
                    rule = SymbolicRule(clause.profiles, subjects, pattern, clause.rule.origin)
                    self._by_key[key, clause.rule.effect].setdefault(rule.content, rule)

    def all(self, key: PermissionKey, effect: Effect) -> dict[tuple[_Profiles, Glob], SymbolicRule]:
        """Return the rules of an effect for a kind and permission without parts, by content."""
        return self._by_key.get((key, effect), {})

    def surely(self, key: PermissionKey, effect: Effect, subjects: Glob) -> tuple[SymbolicEntry, ...]:
        """Return entries of the rules that may apply to some subjects, without those that are too complex."""
        return tuple(one.entry() for one in self.applying(key, effect, subjects) if one.reach.exact)

    def perhaps(self, key: PermissionKey, effect: Effect, subjects: Glob) -> tuple[SymbolicEntry, ...]:
        """Return entries of the rules that may apply to some subjects, over-approximated where they are too complex."""
        return tuple(one.entry() for one in self.applying(key, effect, subjects))

    def _find_applying(self, key: PermissionKey, effect: Effect, subjects: Glob) -> tuple[SymbolicRule, ...]:
        """Return the rules that may apply to subjects that a pattern matches."""
        by_profiles, index = self._index(key, effect)
        near = dict.fromkeys(profiles for _, profiles in index.meeting(subjects))
        return tuple(rule for profiles in near for rule in by_profiles[profiles])

    def _indexed(
        self, key: PermissionKey, effect: Effect
    ) -> tuple[dict[_Profiles, list[SymbolicRule]], PatternIndex[_Profiles]]:
        """Return rules by the profiles around them, and these profiles by the patterns of their subjects."""
        by_profiles: dict[_Profiles, list[SymbolicRule]] = defaultdict(list)
        for rule in self.all(key, effect).values():
            by_profiles[rule.profiles].append(rule)
        subjects = ((one, profiles) for profiles, (rule, *_) in by_profiles.items() for one in rule.reach.subjects)
        return by_profiles, PatternIndex(subjects)


def profile_reach(profiles: _Profiles) -> tuple[ProfileReach, tuple[str, ...]]:
    """Return the subjects that nested profiles match by patterns, and those that they match exactly."""
    exact: tuple[Glob, ...] = ()
    for depth in range(len(profiles), 0, -1):
        try:
            patterns = profile_subjects(profiles[:depth])
        except TooComplexError:
            continue
        if depth == len(profiles):
            exact = patterns
        if depth > 1 and len(patterns) > max(_MOST_PIECES, *map(len, profiles)):
            continue
        singles = tuple(name for one in patterns if (name := literal(one)) is not None)
        return ProfileReach(tuple(one for one in patterns if literal(one) is None), profiles[depth:], exact), singles
    return ProfileReach((EVERY,), profiles, ()), ()
