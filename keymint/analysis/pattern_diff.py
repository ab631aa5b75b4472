"""Compare two policies for all subjects that neither names: what any of them gains or loses.

Only a rule in just one of the policies can make a difference. For each such rule one search covers all subjects and
objects at once (:mod:`keymint.analysis.symbolic_search`); rules in both policies cost nothing.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from comarmor.errors import Origin
from comarmor.patterns.decision_lists import Equal, Unknown
from comarmor.patterns.glob import Glob
from comarmor.patterns.matching import matches
from comarmor.patterns.relations import disjoint
from comarmor.rules import PERMISSIONS, Effect
from keymint.analysis.query_budget import QueryBudget
from keymint.analysis.rule_lists import PermissionKey, allow_only, decision_list, find_permitted, is_composite, negated
from keymint.analysis.subject_patterns import EVERY, example_subject, rules_of
from keymint.analysis.subject_templates import exact_halves, fill_placeholders, fit_pattern, placeholders
from keymint.analysis.symbolic_rules import SymbolicRule, SymbolicRules
from keymint.analysis.symbolic_search import (
    EVERYBODY,
    FoundSubject,
    SymbolicCondition,
    Undecided,
    find_subject,
)
from keymint.api import LoadedPolicy

KEYS: tuple[PermissionKey, ...] = tuple(
    (kind, permission)
    for kind, permissions in PERMISSIONS.items()
    for permission in permissions
    if not is_composite(kind, permission)
)
"""All kinds and permissions without parts: policies that agree on them agree on all."""


@dataclass(frozen=True, slots=True)
class PatternDifference:
    """What the subjects of a pattern gain or lose.

    Attributes:
        gains: True if only the newer policy allows it, False if only the older one does.
        key: kind, and permission without parts; empty if the budget was spent before the last search.
        subjects: the pattern.
        object: pattern of symbolic words of the rule that allows it.
        where: that rule; None if the budget was spent.
        subject: an example; empty if unknown.
        unknown: why it is unknown, or empty.
    """

    gains: bool
    key: PermissionKey
    subjects: Glob
    object: Glob
    where: Origin | None
    subject: str
    unknown: str = ""


def pattern_differences(
    policies: tuple[LoadedPolicy, LoadedPolicy],
    written: tuple[SymbolicRules, SymbolicRules],
    named: Iterable[str],
    budget: QueryBudget,
) -> Iterator[PatternDifference]:
    """Yield what subjects gain or lose. No result proves that no subject does, whatever its name.

    Args:
        policies: the older one and the newer one.
        written: the rules of both.
        named: subjects to ignore.
        budget: limit of the search.
    """
    old, new = written
    named = tuple(named)
    for comparison in (
        _PatternComparison(True, policies, (old, new), named, budget),
        _PatternComparison(False, policies[::-1], (new, old), named, budget),
    ):
        for key in KEYS:
            for each in comparison.of(key):
                if each.unknown and budget.is_empty:
                    yield PatternDifference(each.gains, ("", ""), EVERY, (), None, "", budget.reason(each.unknown))
                    return
                yield each


class _PatternComparison:
    """Finds what one policy allows and another one does not.

    Args:
        gains: the policy that allows it is the newer one.
        policies: the one that does not allow it, and the one that does.
        rules: the rules of both.
        named: subjects to ignore.
        budget: limit of the search.
    """

    def __init__(
        self,
        gains: bool,
        policies: Sequence[LoadedPolicy],
        rules: tuple[SymbolicRules, SymbolicRules],
        named: tuple[str, ...],
        budget: QueryBudget,
    ) -> None:
        self._gains = gains
        self._policies = policies
        self._before, self._after = rules
        self._named = named
        self._budget = budget
        self._reported: dict[Glob, dict[str, None]] = defaultdict(dict)
        self._known_matches: dict[Glob, frozenset[str]] = {}

    def of(self, key: PermissionKey) -> Iterator[PatternDifference]:
        """Yield the differences for a kind and permission, at most one for each rule and pattern of its subjects."""
        allowed = self._after.all(key, Effect.ALLOW)
        new = allowed.keys() - self._before.all(key, Effect.ALLOW).keys()
        denials = self._before.all(key, Effect.DENY)
        lifted = [denials[content] for content in denials.keys() - self._after.all(key, Effect.DENY).keys()]
        if not new and not lifted:
            return
        lifted.sort(key=lambda one: (one.where, str(one.content)))
        for content, rule in allowed.items():
            for subjects in rule.reach.subjects:
                searches = [self._not_allowed_before(key, rule, subjects)] if content in new else []
                searches += self._denied_before(key, rule, subjects, lifted)
                answer = self._first(key, rule, subjects, searches) if searches else None
                if isinstance(answer, FoundSubject):
                    self._reported[subjects][answer.subject] = None
                    yield PatternDifference(self._gains, key, subjects, rule.object, rule.where, answer.subject)
                elif answer is not None:
                    yield PatternDifference(self._gains, key, subjects, rule.object, rule.where, "", answer.reason)

    def _first(
        self, key: PermissionKey, rule: SymbolicRule, subjects: Glob, searches: Sequence[_AlternativeSearches]
    ) -> FoundSubject | Undecided | None:
        """Return the first subject found by a search, else the reason why one of them is undecided."""

        def check(subject: str) -> bool | Undecided:
            return self._differs(key, rule.object, subject)

        tried = [*self._reported[subjects], *self._example(subjects)]
        for subject in tried:
            if check(subject) is True:
                return FoundSubject(subject)
        undecided: Undecided | None = None
        for alternatives in searches:
            answer: FoundSubject | Undecided | None = None
            for within, shape, conditions in alternatives:
                excluded = (*self._matching_named(within), *tried)
                answer = find_subject(key[0], within, shape, conditions, check, excluded, self._budget)
                if not isinstance(answer, Undecided):
                    break
            if isinstance(answer, FoundSubject):
                return answer
            undecided = undecided or answer
        return undecided

    def _example(self, subjects: Glob) -> tuple[str, ...]:
        example = example_subject(subjects)
        return () if example is None or example in self._matching_named(subjects) else (example,)

    def _matching_named(self, subjects: Glob) -> frozenset[str]:
        """Return the named subjects that match a pattern."""
        if subjects not in self._known_matches:
            self._known_matches[subjects] = frozenset(name for name in self._named if matches(subjects, name))
        return self._known_matches[subjects]

    def _not_allowed_before(self, key: PermissionKey, rule: SymbolicRule, subjects: Glob) -> _AlternativeSearches:
        """Return the search for what a rule allows and no rule allowed before."""
        excluded = (
            *self._after.surely(key, Effect.DENY, subjects),
            *self._before.surely(key, Effect.ALLOW, subjects),
        )
        return [(subjects, rule.object, (*rule.reach.conditions, SymbolicCondition(excluded)))]

    def _denied_before(
        self, key: PermissionKey, rule: SymbolicRule, subjects: Glob, lifted: Sequence[SymbolicRule]
    ) -> Iterator[_AlternativeSearches]:
        """Yield searches for what a rule allows and a lifted rule denied before."""
        overlapping = [denial for denial in lifted if _may_overlap(denial, rule, subjects)]
        if not overlapping:
            return
        conditions = (*rule.reach.conditions, SymbolicCondition(self._after.surely(key, Effect.DENY, subjects)))
        entries = tuple(denial.entry() for denial in overlapping if not placeholders(denial.object))
        if entries:
            yield [(subjects, rule.object, (*conditions, SymbolicCondition(some=entries)))]
        for denial in overlapping:
            if placeholders(denial.object):
                yield [*self._alternatives(rule, subjects, denial, conditions)]

    @staticmethod
    def _alternatives(
        rule: SymbolicRule, subjects: Glob, denial: SymbolicRule, conditions: _Conditions
    ) -> Iterator[_SearchArguments]:
        """Yield alternative searches for what a rule allows and a denial with placeholders denied."""
        both = (*conditions, *denial.reach.conditions, SymbolicCondition(some=(denial.entry(),)))
        alternatives = [(subjects, denial.object, (*both, SymbolicCondition(some=(rule.entry(),))))]
        if placeholders(rule.object):
            alternatives.append((subjects, rule.object, both))
        yield from sorted(alternatives, key=_inexact_entries)

    def _differs(self, key: PermissionKey, pattern: Glob, subject: str) -> bool | Undecided:
        """Return True if only one policy allows a subject something that a pattern matches."""
        concrete = fill_placeholders(pattern, *exact_halves(subject))
        before, after = (decision_list(rules_of(policy, subject), key) for policy in self._policies)
        budget = self._budget.next_query()
        outcome = find_permitted(key[0], allow_only(concrete), after, negated(before), budget=budget)
        if isinstance(outcome, Unknown):
            return Undecided(self._budget.reason(outcome.reason))
        return not isinstance(outcome, Equal)


_Conditions = tuple[SymbolicCondition, ...]
_SearchArguments = tuple[Glob, Glob, _Conditions]
"""Arguments of :func:`~keymint.analysis.symbolic_search.find_subject`: subjects, shape of the words, conditions."""
_AlternativeSearches = list[_SearchArguments]
"""Searches with the same answer: any of them proves that there is no subject."""


def _inexact_entries(search: _SearchArguments) -> int:
    """Return the number of entries that cannot be rewritten exactly to the placeholders of the shape."""
    _, shape, conditions = search
    entries = (entry for each in conditions for entry in (*each.none, *(each.some or ())))
    return sum(not fit_pattern(entry.object, shape, *EVERYBODY, wide=False).exact for entry in entries)


def _may_overlap(denial: SymbolicRule, rule: SymbolicRule, subjects: Glob) -> bool:
    if not placeholders(denial.object) and not placeholders(rule.object) and disjoint(denial.object, rule.object):
        return False
    return any(not disjoint(one, subjects) for one in denial.reach.subjects)
