"""Who holds a permission: among all subjects there are, not only those that a policy names."""

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
    part_lists,
    pattern_text,
    permission_keys,
    rule_patterns,
    strip_suffix,
)
from keymint.analysis.subject_patterns import can_exist, example_subject, named_subjects, rules_of, structure
from keymint.analysis.symbolic_rules import SymbolicRule, SymbolicRules
from keymint.analysis.symbolic_search import (
    EVERYBODY,
    FoundSubject,
    SymbolicCondition,
    SymbolicEntry,
    Undecided,
    find_subject,
)
from keymint.api import LoadedPolicy
from keymint.ir import Rule


@dataclass(frozen=True, slots=True)
class PermissionHolder:
    """A permission that a subject holds, or may hold.

    Attributes:
        subject: the subject; empty if none was found for certain.
        like: a pattern of subjects that it is one of; empty for a subject that was asked for or that a policy names.
        word: the shortest name that it holds it on; empty if none was found for certain.
        where: the rule that allows it.
        unknown: why it is not certain; empty if it is.
    """

    subject: str
    like: str
    word: str
    where: Origin | None
    unknown: str = ""


def who_can(
    policy: LoadedPolicy, within: Glob, kind: str, permission: str, name: Glob, budget: QueryBudget | None = None
) -> Iterator[PermissionHolder]:
    """Yield who holds a permission: subjects that a policy names first, then one for each pattern of others.

    Where nothing is yielded nobody does: for every subject there is, and every name. A policy whose type does not tell
    how it is written is asked for the subjects that it names only.

    Args:
        policy: the policy.
        within: pattern of the subjects in question.
        kind: kind of the objects.
        permission: a permission of that kind.
        name: pattern of the objects in question; for kind ``topic`` with the partition.
        budget: pays for it.
    """
    exact = literal(within)
    written = structure(policy) if exact is None else None
    book = SymbolicRules(written) if written else None
    singles = (
        [subject for subject in book.singles if matches(within, subject) and can_exist((subject,))] if book else []
    )
    named = (exact,) if exact is not None else tuple(dict.fromkeys((*named_subjects(policy, within), *singles)))
    for subject in named:
        found = shortest_granted(rules_of(policy, subject), kind, permission, name)
        if found is not None:
            yield _said(subject, "", found, policy, kind, permission)
    if book is not None:
        question = _HolderSearch(policy, book, kind, permission, name, frozenset(named), budget or QueryBudget())
        yield from question.others(within)


def shortest_granted(
    rules: Sequence[Rule], kind: str, permission: str, name: Glob, budget: QueryBudget | None = None
) -> Witness | Unknown | None:
    """Return the shortest of some names on which rules grant a permission, or None."""
    lists = part_lists(rules, kind, permission)
    outcome = find_permitted(kind, allow_only(name), *lists, budget=budget.next_query(len(lists)) if budget else None)
    return None if isinstance(outcome, Equal) else outcome


def granting_rule(rules: Sequence[Rule], kind: str, permission: str, word: str) -> Rule | None:
    """Return the first rule that allows a name, itself or its first part."""
    part_kind, part, suffix = parts(kind, permission)[0]
    for rule in rules:
        if rule.effect is not Effect.ALLOW or (part_kind, part) not in permission_keys(rule):
            continue
        for expression in rule.expressions:
            if any(matches(one, word + suffix) for one in rule_patterns(rule, expression, (part_kind, part))):
                return rule
    return None


def _said(
    subject: str, like: str, found: Witness | Unknown, policy: LoadedPolicy, kind: str, permission: str
) -> PermissionHolder:
    if isinstance(found, Unknown):
        return PermissionHolder(subject, like, "", None, found.reason)
    rule = granting_rule(rules_of(policy, subject), kind, permission, found.word)
    return PermissionHolder(subject, like, found.word, rule.origin if rule else None)


class _HolderSearch:
    """Who holds a permission, of the subjects that a policy does not name.

    Args:
        policy: the policy.
        book: what its rules say.
        kind: kind of the objects.
        permission: the permission.
        name: pattern of the objects in question.
        named: subjects that were asked already.
        budget: pays for it.
    """

    def __init__(
        self,
        policy: LoadedPolicy,
        book: SymbolicRules,
        kind: str,
        permission: str,
        name: Glob,
        named: frozenset[str],
        budget: QueryBudget,
    ) -> None:
        self._policy = policy
        self._book = book
        self._kind, self._permission, self._name = kind, permission, name
        self._named = named
        self._budget = budget

    def others(self, within: Glob) -> Iterator[PermissionHolder]:
        """Yield one holder for each pattern of subjects, where there is one."""
        (kind, part, suffix), *_ = parts(self._kind, self._permission)
        told: set[Glob] = set()
        doubts: dict[Glob, str] = {}
        for spoken in self._book.all((kind, part), Effect.ALLOW).values():
            for subjects in (piece for one in spoken.reach.subjects for piece in _both(one, within)):
                if subjects in told:
                    continue
                for shape in _before(spoken.object, suffix):
                    found = self._holder(subjects, shape, spoken)
                    if isinstance(found, Undecided):
                        doubts.setdefault(subjects, found.reason)
                    elif found is not None:
                        told.add(subjects)
                        yield from self._said(found.subject, subjects)
                        break
        for subjects, reason in doubts.items():
            if subjects not in told:
                yield PermissionHolder("", pattern_text(subjects), "", None, reason)

    def _holder(self, subjects: Glob, shape: Glob, spoken: SymbolicRule) -> FoundSubject | Undecided | None:
        first = example_subject(subjects)
        tried = [] if first is None or first in self._named else [first]
        for subject in tried:
            if self._judge(subject) is True:
                return FoundSubject(subject)
        excluded = {subject for subject in self._named if matches(subjects, subject)}
        conditions = (*spoken.reach.conditions, *self._conditions(subjects))
        return find_subject(self._kind, subjects, shape, conditions, self._judge, (*excluded, *tried), self._budget)

    def _conditions(self, subjects: Glob) -> Iterator[SymbolicCondition]:
        """Yield what the rules require: of an action or parameter that each of its parts is allowed."""
        yield SymbolicCondition(some=(SymbolicEntry((EVERYBODY,), self._name),))
        for number, (kind, part, suffix) in enumerate(parts(self._kind, self._permission)):
            key = (kind, part)
            yield SymbolicCondition(tuple(_without(self._book.surely(key, Effect.DENY, subjects), suffix)))
            if number:
                yield SymbolicCondition(some=tuple(_without(self._book.perhaps(key, Effect.ALLOW, subjects), suffix)))

    def _judge(self, subject: str) -> bool | Undecided:
        found = shortest_granted(
            rules_of(self._policy, subject), self._kind, self._permission, self._name, self._budget
        )
        return Undecided(self._budget.reason(found.reason)) if isinstance(found, Unknown) else found is not None

    def _said(self, subject: str, subjects: Glob) -> Iterator[PermissionHolder]:
        found = shortest_granted(rules_of(self._policy, subject), self._kind, self._permission, self._name)
        if found is not None:
            yield _said(subject, pattern_text(subjects), found, self._policy, self._kind, self._permission)


def _both(one: Glob, other: Glob) -> tuple[Glob, ...]:
    """Return patterns that together match what two have in common; what one of them matches if that is too much."""
    try:
        return intersection(one, other)
    except TooComplexError:
        return (one,)


def _before(pattern: Glob, suffix: str) -> tuple[Glob, ...]:
    """Return patterns of the words that a pattern matches with a suffix."""
    return strip_suffix(allow_only(pattern), suffix)[0].patterns


def _without(entries: Sequence[SymbolicEntry], suffix: str) -> Iterator[SymbolicEntry]:
    for entry in entries:
        yield from (SymbolicEntry(entry.subjects, pattern) for pattern in _before(entry.object, suffix))
