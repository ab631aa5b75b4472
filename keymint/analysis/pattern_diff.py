# SPDX-License-Identifier: Apache-2.0
"""Search subjects that neither of two policies names for one that gains or loses something.

Only a rule in just one of the policies can make a difference. For each such rule one search covers all subjects and
objects at once (:mod:`keymint.analysis.symbolic_search`); rules in both policies cost nothing.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import cache, partial
from itertools import product

from comarmor.patterns.decision_lists import Unknown, negate
from comarmor.patterns.glob import Glob, matches
from comarmor.patterns.relations import disjoint
from comarmor.rules import PARTS, PERMISSIONS, Effect
from comarmor.values import dataclass
from keymint.analysis.query_budget import QueryBudget
from keymint.analysis.rule_lists import PermissionKey, decision_list, deny_over_allow, find_permitted, overlap
from keymint.analysis.subject_patterns import SubjectClass, rules_of
from keymint.analysis.subject_templates import exact_halves, fill_placeholders, fit_pattern, placeholders
from keymint.analysis.symbolic_rules import SymbolicRule, SymbolicRules
from keymint.analysis.symbolic_search import EVERYBODY, SymbolicCondition, SymbolicEntry, find_subject
from keymint.api import LoadedPolicy

KEYS: tuple[PermissionKey, ...] = tuple(
    key for kind, permissions in PERMISSIONS.items() for key in product((kind,), permissions) if key not in PARTS
)
"""The permissions without parts: policies that agree on these agree on all."""
_ROUNDS = 16
"""Maximum number of examples for a rule and a pattern of its subjects."""


@dataclass(frozen=True, slots=True)
class PatternDifference:
    """A difference for subjects that no policy names.

    Attributes:
        rule: the rule that allows it.
        within: pattern of the subjects that were searched.
        found: an example, or why it is not known whether there is one.
    """

    rule: SymbolicRule
    within: Glob
    found: str | Unknown


class PatternComparison:
    """Finds what one policy allows and another one does not.

    Args:
        gains: the policy that allows it is the newer one; also an attribute.
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
        named: Iterable[str],
        budget: QueryBudget,
    ) -> None:
        self.gains = gains
        self._policies = policies
        self._before, self._after = rules
        self._budget = budget
        named = tuple(named)
        # Returns the named subjects that match a pattern.
        self._matching_named = cache(lambda pattern: tuple((name,) for name in named if matches(pattern, name)))
        self._changed = cache(self._changed_rules)

    def differences(
        self, key: PermissionKey, area: SubjectClass, said: Sequence[Glob], listed: Sequence[SubjectClass]
    ) -> Iterator[PatternDifference]:
        """Yield differences for a kind and permission; no result proves that there is none.

        Args:
            key: the permission.
            area: the subjects to search.
            said: patterns of symbolic words to ignore.
            listed: classes of subjects to ignore; may grow between results.
        """
        new, lifted = self._changed(key)
        if not new and not lifted:
            return
        for rule in self._after.applying(key, Effect.ALLOW, area.like):
            for subjects in dict.fromkeys(each for one in rule.reach.subjects for each in overlap(area.like, one)):
                searches = [self._not_allowed_before(key, rule, subjects)] if rule.content in new else []
                searches += self._denied_before(key, rule, subjects, lifted)
                for left in reversed(range(_ROUNDS + 1) if searches else ()):
                    part = SubjectClass(subjects, area.excluded)
                    answer = self._first(key, rule, part, searches, said, listed)
                    if answer is None:
                        break
                    if not left:
                        answer = Unknown(f"its subjects change in more than {_ROUNDS} ways")
                    yield PatternDifference(rule, subjects, answer)
                    if isinstance(answer, Unknown):
                        break

    def _changed_rules(self, key: PermissionKey) -> tuple[set[object], tuple[SymbolicRule, ...]]:
        """Return the contents of the new rules that allow something, and the old rules that denied something."""
        new = self._after.all(key, Effect.ALLOW).keys() - self._before.all(key, Effect.ALLOW).keys()
        denials = self._before.all(key, Effect.DENY)
        lifted = [denials[content] for content in denials.keys() - self._after.all(key, Effect.DENY).keys()]
        return {*new}, tuple(sorted(lifted, key=lambda one: (one.where, str(one.content))))

    def _first(
        self,
        key: PermissionKey,
        rule: SymbolicRule,
        area: SubjectClass,
        searches: Sequence[_Alternatives],
        said: Sequence[Glob],
        listed: Sequence[SubjectClass],
    ) -> str | Unknown | None:
        """Return the first subject found by a search, else the reason why one of them is undecided."""
        check = cache(partial(self._differs, key, rule.object, said))
        excluded = (*area.excluded, *self._matching_named(area.like))
        listed = [each for each in listed if not disjoint(each.like, area.like)]
        more = (SymbolicCondition(tuple(SymbolicEntry((EVERYBODY,), each) for each in said), some=False),)
        undecided: Unknown | None = None
        for alternatives in searches:
            answer: str | Unknown | None = None
            for shape, each in alternatives:
                answer = find_subject(key[0], area.like, shape, (*each, *more), check, excluded, self._budget, listed)
                if not isinstance(answer, Unknown):
                    break
            if isinstance(answer, str):
                return answer
            undecided = undecided or answer
        return undecided

    def _not_allowed_before(self, key: PermissionKey, rule: SymbolicRule, subjects: Glob) -> _Alternatives:
        """Return the search for what a rule allows and no rule allowed before."""
        excluded = (
            *self._after.surely(key, Effect.DENY, subjects),
            *self._before.surely(key, Effect.ALLOW, subjects),
        )
        return [(rule.object, (*rule.reach.conditions, SymbolicCondition(excluded, some=False)))]

    def _denied_before(
        self, key: PermissionKey, rule: SymbolicRule, subjects: Glob, lifted: Sequence[SymbolicRule]
    ) -> Iterator[_Alternatives]:
        """Yield searches for what a rule allows and a lifted rule denied before."""
        overlapping = [denial for denial in lifted if denial.may_meet(rule.object, SubjectClass(subjects))]
        if not overlapping:
            return
        denied = SymbolicCondition(self._after.surely(key, Effect.DENY, subjects), some=False)
        conditions = (*rule.reach.conditions, denied)
        entries = tuple(denial.entry() for denial in overlapping if not placeholders(denial.object))
        if entries:
            yield [(rule.object, (*conditions, SymbolicCondition(entries, some=True)))]
        for denial in overlapping:
            if placeholders(denial.object):
                both = (*conditions, *denial.reach.conditions, SymbolicCondition((denial.entry(),), some=True))
                alternatives = [(denial.object, (*both, SymbolicCondition((rule.entry(),), some=True)))]
                if placeholders(rule.object):
                    alternatives.append((rule.object, both))
                yield sorted(alternatives, key=_inexact_entries)

    def _differs(self, key: PermissionKey, pattern: Glob, said: Sequence[Glob], subject: str) -> bool | Unknown:
        """Return True if only one policy allows a subject something that a pattern matches, besides what is ignored."""
        concrete, *ignored = (fill_placeholders(each, *exact_halves(subject)) for each in (pattern, *said))
        before, after = (decision_list(rules_of(policy, subject), key) for policy in self._policies)
        budget = self._budget.next_query()
        shown = deny_over_allow(ignored, [concrete])
        return self._budget.verdict(find_permitted(key[0], shown, after, negate(before), budget=budget))


_Search = tuple[Glob, tuple[SymbolicCondition, ...]]
"""Arguments of :func:`~keymint.analysis.symbolic_search.find_subject`: shape of the words, and conditions."""
_Alternatives = Sequence[_Search]
"""Searches with the same answer: any of them proves that there is no subject."""


def _inexact_entries(search: _Search) -> int:
    """Return the number of entries that cannot be rewritten exactly to the placeholders of the shape."""
    shape, conditions = search
    entries = (entry for each in conditions for entry in each.entries)
    return sum(not fit_pattern(entry.object, shape, *EVERYBODY, wide=False).exact for entry in entries)
