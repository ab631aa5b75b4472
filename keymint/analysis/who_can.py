"""Find the subjects with a permission, among all possible subjects, not only those that a policy names."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from comarmor.errors import Origin
from comarmor.patterns.decision_lists import Equal, Unknown, Witness
from comarmor.patterns.glob import Glob, literal
from comarmor.patterns.matching import matches
from comarmor.patterns.relations import TooComplexError, intersection
from comarmor.rules import Effect, parts
from keymint.analysis.query_budget import QueryBudget
from keymint.analysis.rule_lists import (
    allow_only,
    find_permitted,
    matching_rule,
    part_lists,
    pattern_text,
    strip_suffix,
)
from keymint.analysis.subject_patterns import can_exist, example_subject, named_subjects, rules_of, structure
from keymint.analysis.symbolic_rules import SymbolicRule, SymbolicRules
from keymint.analysis.symbolic_search import EVERYBODY, SymbolicCondition, SymbolicEntry, find_subject
from keymint.api import LoadedPolicy
from keymint.ir import Rule


@dataclass(frozen=True, slots=True)
class PermissionHolder:
    """A subject that has a permission, or may have it.

    Attributes:
        subject: the subject; empty if unknown.
        like: a pattern of subjects that it is an example of; empty for an exact query and for a named subject.
        word: the shortest name that it has the permission on; empty if unknown.
        where: the rule that allows it.
        unknown: why the answer is unknown, or empty.
    """

    subject: str
    like: str
    word: str
    where: Origin | None
    unknown: str = ""


def who_can(policy: LoadedPolicy, within: Glob, kind: str, permission: str, name: Glob) -> Iterator[PermissionHolder]:
    """Yield subjects with a permission: first those that a policy names, then an example for each pattern of others.

    No result proves that no possible subject has the permission on any name. If the policy type does not provide the
    structure, only the subjects that the policy names are checked.

    Args:
        policy: the policy.
        within: pattern of the subjects.
        kind: kind of the objects.
        permission: a permission of that kind.
        name: pattern of the objects; for kind ``topic`` with the partition.
    """
    exact = literal(within)
    written = structure(policy) if exact is None else None
    rules = SymbolicRules(written) if written else None
    singles = (
        [subject for subject in rules.singles if matches(within, subject) and can_exist((subject,))] if rules else []
    )
    named = (exact,) if exact is not None else tuple(dict.fromkeys((*named_subjects(policy, within), *singles)))
    for subject in named:
        outcome = shortest_granted(rules_of(policy, subject), kind, permission, name)
        if outcome is not None:
            yield _holder_of(subject, "", outcome, policy, kind, permission)
    if rules is not None:
        search = _HolderSearch(policy, rules, kind, permission, name, frozenset(named))
        yield from search.others(within)


def shortest_granted(
    rules: Sequence[Rule], kind: str, permission: str, name: Glob, budget: QueryBudget | None = None
) -> Witness | Unknown | None:
    """Return the shortest of the names on which rules grant a permission, or None."""
    lists = part_lists(rules, kind, permission)
    outcome = find_permitted(kind, allow_only(name), *lists, budget=budget.next_query(len(lists)) if budget else None)
    return None if isinstance(outcome, Equal) else outcome


def _holder_of(
    subject: str, like: str, outcome: Witness | Unknown, policy: LoadedPolicy, kind: str, permission: str
) -> PermissionHolder:
    if isinstance(outcome, Unknown):
        return PermissionHolder(subject, like, "", None, outcome.reason)
    rule = matching_rule(rules_of(policy, subject), Effect.ALLOW, kind, permission, outcome.word)
    return PermissionHolder(subject, like, outcome.word, rule.origin if rule else None)


class _HolderSearch:
    """Finds subjects with a permission among those that a policy does not name.

    Args:
        policy: the policy.
        rules: its symbolic rules.
        kind: kind of the objects.
        permission: the permission.
        name: pattern of the objects.
        named: subjects that are already checked.
    """

    def __init__(
        self,
        policy: LoadedPolicy,
        rules: SymbolicRules,
        kind: str,
        permission: str,
        name: Glob,
        named: frozenset[str],
    ) -> None:
        self._policy = policy
        self._rules = rules
        self._kind, self._permission, self._name = kind, permission, name
        self._named = named
        self._budget = QueryBudget()

    def others(self, within: Glob) -> Iterator[PermissionHolder]:
        """Yield an example for each pattern of subjects with the permission."""
        (kind, part, suffix), *_ = parts(self._kind, self._permission)
        reported: set[Glob] = set()
        unknown: dict[Glob, str] = {}
        for rule in self._rules.all((kind, part), Effect.ALLOW).values():
            for subjects in (piece for one in rule.reach.subjects for piece in _both(one, within)):
                if subjects in reported:
                    continue
                for shape in _before(rule.object, suffix):
                    answer = self._holder(subjects, shape, rule)
                    if isinstance(answer, Unknown):
                        unknown.setdefault(subjects, answer.reason)
                    elif answer is not None:
                        reported.add(subjects)
                        yield from self._example(answer, subjects)
                        break
        for subjects, reason in unknown.items():
            if subjects not in reported:
                yield PermissionHolder("", pattern_text(subjects), "", None, reason)

    def _holder(self, subjects: Glob, shape: Glob, rule: SymbolicRule) -> str | Unknown | None:
        first = example_subject(subjects)
        tried = [] if first is None or first in self._named else [first]
        for subject in tried:
            if self._check(subject) is True:
                return subject
        excluded = {subject for subject in self._named if matches(subjects, subject)}
        conditions = (*rule.reach.conditions, *self._conditions(subjects))
        return find_subject(self._kind, subjects, shape, conditions, self._check, (*excluded, *tried), self._budget)

    def _conditions(self, subjects: Glob) -> Iterator[SymbolicCondition]:
        """Yield the conditions of the rules; a composite permission requires all its parts."""
        yield SymbolicCondition(some=(SymbolicEntry((EVERYBODY,), self._name),))
        for number, (kind, part, suffix) in enumerate(parts(self._kind, self._permission)):
            key = (kind, part)
            yield SymbolicCondition(tuple(_without(self._rules.surely(key, Effect.DENY, subjects), suffix)))
            if number:
                yield SymbolicCondition(some=tuple(_without(self._rules.perhaps(key, Effect.ALLOW, subjects), suffix)))

    def _check(self, subject: str) -> bool | Unknown:
        outcome = shortest_granted(
            rules_of(self._policy, subject), self._kind, self._permission, self._name, self._budget
        )
        return Unknown(self._budget.reason(outcome.reason)) if isinstance(outcome, Unknown) else outcome is not None

    def _example(self, subject: str, subjects: Glob) -> Iterator[PermissionHolder]:
        outcome = shortest_granted(rules_of(self._policy, subject), self._kind, self._permission, self._name)
        if outcome is not None:
            yield _holder_of(subject, pattern_text(subjects), outcome, self._policy, self._kind, self._permission)


def _both(one: Glob, other: Glob) -> tuple[Glob, ...]:
    """Return the intersection of two patterns, or the first one if that is too complex."""
    try:
        return intersection(one, other)
    except TooComplexError:
        return (one,)


def _before(pattern: Glob, suffix: str) -> tuple[Glob, ...]:
    """Return patterns of the words that a pattern matches with the suffix appended."""
    return strip_suffix(allow_only(pattern), suffix)[0].patterns


def _without(entries: Sequence[SymbolicEntry], suffix: str) -> Iterator[SymbolicEntry]:
    for entry in entries:
        yield from (SymbolicEntry(entry.subjects, pattern) for pattern in _before(entry.object, suffix))
