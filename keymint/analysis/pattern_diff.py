"""Two policies compared for all subjects that neither names: what any of them gains or loses.

Only a rule that one policy has and the other has not can make a difference. So for each such rule one question is asked
about all subjects and objects at once (:mod:`keymint.analysis.symbolic_search`); rules that both have cost nothing.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from comarmor.errors import Origin
from comarmor.patterns.decision_lists import Block, Equal, Unknown
from comarmor.patterns.glob import Glob
from comarmor.patterns.matching import matches
from comarmor.patterns.relations import disjoint
from comarmor.rules import PERMISSIONS, Effect
from keymint.analysis.query_budget import QueryBudget
from keymint.analysis.rule_lists import PermissionKey, decision_list, find_permitted, is_composite, negated
from keymint.analysis.subject_patterns import EVERY, example_subject, rules_of
from keymint.analysis.subject_templates import fill_placeholders, fit_pattern, placeholders
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
    for kind, held in PERMISSIONS.items()
    for permission in held
    if not is_composite(kind, permission)
)
"""Every kind with each permission of it that has no parts: where these are equal, all are."""


@dataclass(frozen=True, slots=True)
class PatternDifference:
    """What subjects that a pattern matches gain or lose.

    Attributes:
        gains: the newer policy allows what the older does not; else the other way round.
        key: kind, and permission without parts; empty where the budget was spent before all was asked.
        subjects: the pattern.
        object: pattern of symbolic words of the rule that allows it.
        where: that rule; None where the budget was spent.
        subject: one that gains or loses; empty if none was found for certain.
        unknown: why none was.
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
    """Yield what subjects gain or lose; where nothing is yielded none does, whatever its name.

    Args:
        policies: the older one and the newer one.
        written: what the rules of both say.
        named: subjects that do not count.
        budget: pays for it.
    """
    old, new = written
    named = tuple(named)
    for comparison in (
        _PatternComparison(True, policies, (old, new), named, budget),
        _PatternComparison(False, policies[::-1], (new, old), named, budget),
    ):
        for key in KEYS:
            for found in comparison.of(key):
                if found.unknown and budget.is_empty:
                    yield PatternDifference(found.gains, ("", ""), EVERY, (), None, "", budget.reason(found.unknown))
                    return
                yield found


class _PatternComparison:
    """What subjects may do by one policy, and not by another one.

    Args:
        gains: the policy that allows it is the newer one.
        policies: the one that does not allow it, and the one that does.
        books: what the rules of both say.
        named: subjects that do not count.
        budget: pays for it.
    """

    def __init__(
        self,
        gains: bool,
        policies: Sequence[LoadedPolicy],
        books: tuple[SymbolicRules, SymbolicRules],
        named: tuple[str, ...],
        budget: QueryBudget,
    ) -> None:
        self._gains = gains
        self._policies = policies
        self._before, self._after = books
        self._named = named
        self._budget = budget
        self._shown: dict[Glob, dict[str, None]] = defaultdict(dict)
        self._excluded: dict[Glob, frozenset[str]] = {}

    def of(self, key: PermissionKey) -> Iterator[PatternDifference]:
        """Yield, for each rule and pattern of subjects, whether it makes a difference for a kind and permission."""
        allowed = self._after.all(key, Effect.ALLOW)
        new = allowed.keys() - self._before.all(key, Effect.ALLOW).keys()
        denials = self._before.all(key, Effect.DENY)
        lifted = [denials[said] for said in denials.keys() - self._after.all(key, Effect.DENY).keys()]
        if not new and not lifted:
            return
        lifted.sort(key=lambda one: (one.where, str(one.said)))
        for said, spoken in allowed.items():
            for subjects in spoken.reach.subjects:
                questions = [self._unspoken(key, spoken, subjects)] if said in new else []
                questions += self._denied(key, spoken, subjects, lifted)
                found = self._first(key, spoken, subjects, questions) if questions else None
                if isinstance(found, FoundSubject):
                    self._shown[subjects][found.subject] = None
                    yield self._said(key, spoken, subjects, found.subject, "")
                elif found is not None:
                    yield self._said(key, spoken, subjects, "", found.reason)

    def _said(
        self, key: PermissionKey, spoken: SymbolicRule, subjects: Glob, subject: str, unknown: str
    ) -> PatternDifference:
        return PatternDifference(self._gains, key, subjects, spoken.object, spoken.where, subject, unknown)

    def _first(
        self, key: PermissionKey, spoken: SymbolicRule, subjects: Glob, questions: Sequence[_AlternativeSearches]
    ) -> FoundSubject | Undecided | None:
        """Return the answer to the first question that finds a subject; else why one of them was not decided."""

        def judge(subject: str) -> bool | Undecided:
            return self._differs(key, spoken.object, subject)

        tried = [*self._shown[subjects], *self._example(subjects)]
        for subject in tried:
            if judge(subject) is True:
                return FoundSubject(subject)
        undecided: Undecided | None = None
        for question in questions:
            answer: FoundSubject | Undecided | None = None
            for within, shape, conditions in question:
                excluded = (*self._known(within), *tried)
                answer = find_subject(key[0], within, shape, conditions, judge, excluded, self._budget)
                if not isinstance(answer, Undecided):
                    break
            if isinstance(answer, FoundSubject):
                return answer
            undecided = undecided or answer
        return undecided

    def _example(self, subjects: Glob) -> tuple[str, ...]:
        found = example_subject(subjects)
        return () if found is None or found in self._known(subjects) else (found,)

    def _known(self, subjects: Glob) -> frozenset[str]:
        """Return the subjects that do not count, of those that a pattern matches."""
        if subjects not in self._excluded:
            self._excluded[subjects] = frozenset(name for name in self._named if matches(subjects, name))
        return self._excluded[subjects]

    def _unspoken(self, key: PermissionKey, spoken: SymbolicRule, subjects: Glob) -> _AlternativeSearches:
        """Return the question whether a rule allows what no rule allowed."""
        refused = (
            *self._after.surely(key, Effect.DENY, subjects),
            *self._before.surely(key, Effect.ALLOW, subjects),
        )
        return [(subjects, spoken.object, (*spoken.reach.conditions, SymbolicCondition(refused)))]

    def _denied(
        self, key: PermissionKey, spoken: SymbolicRule, subjects: Glob, lifted: Sequence[SymbolicRule]
    ) -> Iterator[_AlternativeSearches]:
        """Yield the questions whether a rule allows what was denied."""
        near = [one for one in lifted if _may_meet(one, spoken, subjects)]
        if not near:
            return
        mine = (*spoken.reach.conditions, SymbolicCondition(self._after.surely(key, Effect.DENY, subjects)))
        entries = tuple(one.entry() for one in near if not placeholders(one.object))
        if entries:
            yield [(subjects, spoken.object, (*mine, SymbolicCondition(some=entries)))]
        for one in near:
            if placeholders(one.object):
                yield [*self._both(spoken, subjects, one, mine)]

    @staticmethod
    def _both(
        spoken: SymbolicRule, subjects: Glob, denial: SymbolicRule, mine: _Conditions
    ) -> Iterator[_SearchArguments]:
        """Yield the ways to ask whether a rule allows what a denial that depends on the subject denied."""
        conditions = (*mine, *denial.reach.conditions, SymbolicCondition(some=(denial.entry(),)))
        ways = [(subjects, denial.object, (*conditions, SymbolicCondition(some=(spoken.entry(),))))]
        if placeholders(spoken.object):
            ways.append((subjects, spoken.object, conditions))
        yield from sorted(ways, key=_blurred)

    def _differs(self, key: PermissionKey, pattern: Glob, subject: str) -> bool | Undecided:
        """Tell whether a subject may do by one policy, and not by the other one, something that a pattern matches."""
        head, _, last = subject.removeprefix("/").rpartition("/")
        mine = fill_placeholders(pattern, (f"{head}/",) if head else (), (last,))
        before, after = (decision_list(rules_of(policy, subject), key) for policy in self._policies)
        asked = (Block(True, (mine,)),)
        outcome = find_permitted(key[0], asked, after, negated(before), budget=self._budget.next_query())
        if isinstance(outcome, Unknown):
            return Undecided(self._budget.reason(outcome.reason))
        return not isinstance(outcome, Equal)


_Conditions = tuple[SymbolicCondition, ...]
_SearchArguments = tuple[Glob, Glob, _Conditions]
"""Arguments of :func:`~keymint.analysis.symbolic_search.find_subject`: subjects, shape of the names, conditions."""
_AlternativeSearches = list[_SearchArguments]
"""Ways to ask the same; "there is none" is proven by any of them."""


def _blurred(way: _SearchArguments) -> int:
    """Return how many expressions cannot be said exactly where the placeholders stand as in the shape of the words."""
    _, shape, conditions = way
    entries = (entry for each in conditions for entry in (*each.none, *(each.some or ())))
    return sum(not fit_pattern(entry.object, shape, *EVERYBODY, wide=False).exact for entry in entries)


def _may_meet(denial: SymbolicRule, spoken: SymbolicRule, subjects: Glob) -> bool:
    if not placeholders(denial.object) and not placeholders(spoken.object) and disjoint(denial.object, spoken.object):
        return False
    return any(not disjoint(one, subjects) for one in denial.reach.subjects)
