# SPDX-License-Identifier: Apache-2.0
"""Compare two policies for all subjects that neither names: what any of them gains or loses.

Only a rule in just one of the policies can make a difference. For each such rule one search covers all subjects and
objects at once (:mod:`keymint.analysis.symbolic_search`); rules in both policies cost nothing.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from itertools import product

from comarmor.patterns.decision_lists import Equal, Unknown, negated
from comarmor.patterns.glob import Glob
from comarmor.patterns.matching import matches
from comarmor.patterns.relations import disjoint
from comarmor.rules import PARTS, PERMISSIONS, Effect
from keymint.analysis.query_budget import QueryBudget
from keymint.analysis.rule_diff import PermissionChange, unknown_change
from keymint.analysis.rule_lists import PermissionKey, allow_only, decision_list, find_permitted
from keymint.analysis.subject_patterns import EVERY, example_subject, rules_of
from keymint.analysis.subject_templates import exact_halves, fill_placeholders, fit_pattern, placeholders
from keymint.analysis.symbolic_rules import SymbolicRule, SymbolicRules
from keymint.analysis.symbolic_search import EVERYBODY, SymbolicCondition, find_subject
from keymint.api import LoadedPolicy


def pattern_differences(
    policies: tuple[LoadedPolicy, LoadedPolicy],
    written: tuple[SymbolicRules, SymbolicRules],
    named: Iterable[str],
    budget: QueryBudget,
) -> Iterator[tuple[Glob, str | PermissionChange]]:
    """Yield patterns of subjects, each with an example that gains or loses something, or with an unknown change.

    No result proves that no subject gains or loses anything, whatever its name.

    Args:
        policies: the older one and the newer one.
        written: the rules of both.
        named: subjects to ignore.
        budget: limit of the search.
    """
    named = tuple(named)
    # Policies that agree on the permissions without parts agree on all.
    keys = [
        key for kind, permissions in PERMISSIONS.items() for key in product((kind,), permissions) if key not in PARTS
    ]
    for comparison in (
        _PatternComparison(True, policies, written, named, budget),
        _PatternComparison(False, policies[::-1], written[::-1], named, budget),
    ):
        for key in keys:
            for subjects, difference in comparison.of(key):
                if isinstance(difference, PermissionChange) and budget.is_empty:
                    yield EVERY, unknown_change(budget.reason(difference.unknown))
                    return
                yield subjects, difference


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
        policies: tuple[LoadedPolicy, LoadedPolicy],
        rules: tuple[SymbolicRules, SymbolicRules],
        named: tuple[str, ...],
        budget: QueryBudget,
    ) -> None:
        self._gains = gains
        self._policies = policies
        self._before, self._after = rules
        self._budget = budget
        self._reported: dict[Glob, dict[str, None]] = defaultdict(dict)
        # Returns the named subjects that match a pattern.
        self._matching_named = cache(lambda pattern: frozenset(name for name in named if matches(pattern, name)))

    def of(self, key: PermissionKey) -> Iterator[tuple[Glob, str | PermissionChange]]:
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
                if isinstance(answer, str):
                    self._reported[subjects][answer] = None
                    yield subjects, answer
                elif answer is not None:
                    change = PermissionChange(self._gains, *key, rule.object, False, "", rule.where, answer.reason)
                    yield subjects, change

    def _first(
        self, key: PermissionKey, rule: SymbolicRule, subjects: Glob, searches: Sequence[_AlternativeSearches]
    ) -> str | Unknown | None:
        """Return the first subject found by a search, else the reason why one of them is undecided."""

        def check(subject: str) -> bool | Unknown:
            return self._differs(key, rule.object, subject)

        tried = [*self._reported[subjects], *self._example(subjects)]
        for subject in tried:
            if check(subject) is True:
                return subject
        undecided: Unknown | None = None
        for alternatives in searches:
            answer: str | Unknown | None = None
            for within, shape, conditions in alternatives:
                excluded = (*self._matching_named(within), *tried)
                answer = find_subject(key[0], within, shape, conditions, check, excluded, self._budget)
                if not isinstance(answer, Unknown):
                    break
            if isinstance(answer, str):
                return answer
            undecided = undecided or answer
        return undecided

    def _example(self, subjects: Glob) -> tuple[str, ...]:
        example = example_subject(subjects)
        return () if example is None or example in self._matching_named(subjects) else (example,)

    def _not_allowed_before(self, key: PermissionKey, rule: SymbolicRule, subjects: Glob) -> _AlternativeSearches:
        """Return the search for what a rule allows and no rule allowed before."""
        excluded = (
            *self._after.surely(key, Effect.DENY, subjects),
            *self._before.surely(key, Effect.ALLOW, subjects),
        )
        return [(subjects, rule.object, (*rule.reach.conditions, SymbolicCondition(excluded, some=False)))]

    def _denied_before(
        self, key: PermissionKey, rule: SymbolicRule, subjects: Glob, lifted: Sequence[SymbolicRule]
    ) -> Iterator[_AlternativeSearches]:
        """Yield searches for what a rule allows and a lifted rule denied before."""
        overlapping = [denial for denial in lifted if _may_overlap(denial, rule, subjects)]
        if not overlapping:
            return
        denied = SymbolicCondition(self._after.surely(key, Effect.DENY, subjects), some=False)
        conditions = (*rule.reach.conditions, denied)
        entries = tuple(denial.entry() for denial in overlapping if not placeholders(denial.object))
        if entries:
            yield [(subjects, rule.object, (*conditions, SymbolicCondition(entries, some=True)))]
        for denial in overlapping:
            if placeholders(denial.object):
                yield self._alternatives(rule, subjects, denial, conditions)

    @staticmethod
    def _alternatives(
        rule: SymbolicRule, subjects: Glob, denial: SymbolicRule, conditions: _Conditions
    ) -> _AlternativeSearches:
        """Return alternative searches for what a rule allows and a denial with placeholders denied."""
        both = (*conditions, *denial.reach.conditions, SymbolicCondition((denial.entry(),), some=True))
        alternatives = [(subjects, denial.object, (*both, SymbolicCondition((rule.entry(),), some=True)))]
        if placeholders(rule.object):
            alternatives.append((subjects, rule.object, both))
        return sorted(alternatives, key=_inexact_entries)

    def _differs(self, key: PermissionKey, pattern: Glob, subject: str) -> bool | Unknown:
        """Return True if only one policy allows a subject something that a pattern matches."""
        concrete = fill_placeholders(pattern, *exact_halves(subject))
        before, after = (decision_list(rules_of(policy, subject), key) for policy in self._policies)
        budget = self._budget.next_query()
        outcome = find_permitted(key[0], allow_only(concrete), after, negated(before), budget=budget)
        if isinstance(outcome, Unknown):
            return Unknown(self._budget.reason(outcome.reason))
        return not isinstance(outcome, Equal)


_Conditions = tuple[SymbolicCondition, ...]
_SearchArguments = tuple[Glob, Glob, _Conditions]
"""Arguments of :func:`~keymint.analysis.symbolic_search.find_subject`: subjects, shape of the words, conditions."""
_AlternativeSearches = list[_SearchArguments]
"""Searches with the same answer: any of them proves that there is no subject."""


def _inexact_entries(search: _SearchArguments) -> int:
    """Return the number of entries that cannot be rewritten exactly to the placeholders of the shape."""
    _, shape, conditions = search
    entries = (entry for each in conditions for entry in each.entries)
    return sum(not fit_pattern(entry.object, shape, *EVERYBODY, wide=False).exact for entry in entries)


def _may_overlap(denial: SymbolicRule, rule: SymbolicRule, subjects: Glob) -> bool:
    if not placeholders(denial.object) and not placeholders(rule.object) and disjoint(denial.object, rule.object):
        return False
    return any(not disjoint(one, subjects) for one in denial.reach.subjects)
