# SPDX-License-Identifier: Apache-2.0
"""Answer who can do something, and what a subject can do.

:func:`who_can` finds subjects among all possible ones, not only those that a policy names.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from comarmor.patterns.decision_lists import Equal, ProofResult, Unknown, Witness
from comarmor.patterns.glob import Glob, literal, matches, right_quotient
from comarmor.patterns.relations import disjoint
from comarmor.rules import Effect, parts
from comarmor.values import Data, field
from keymint.analysis.rule_lists import (
    allow_only,
    find_permitted,
    matching_rule,
    overlap,
    part_lists,
    pattern_text,
    query_pattern,
    rule_patterns,
)
from keymint.analysis.subject_patterns import can_exist, named_subjects, rules_of
from keymint.analysis.symbolic_rules import EVERYBODY, Entries, SymbolicEntry, SymbolicRules
from keymint.analysis.symbolic_search import QueryBudget, find_subject
from keymint.api import LoadedPolicy
from keymint.errors import Origin
from keymint.ir import Rule

FORMS = (
    "who can PERMISSION OBJECT",
    "what can SUBJECT do",
    "can SUBJECT [ever] PERMISSION OBJECT",
    "flows SUBJECT SUBJECT",
    "isolated SUBJECT SUBJECT",
)
"""Queries: words in small letters are written as they are; the one in brackets may be left out."""
HEADS = tuple(form.split()[0] for form in FORMS)


class PermissionHolder(Data):
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
    written = policy.structure() if literal(within) is None else None
    rules = SymbolicRules(written) if written else None
    singles = (
        [subject for subject in rules.singles if matches(within, subject) and can_exist((subject,))] if rules else []
    )
    named = tuple(dict.fromkeys((*named_subjects(policy, within), *singles)))
    search = _HolderSearch(policy, kind, permission, name)
    for subject in named:
        yield from search.holder(subject)
    if rules is not None:
        yield from search.others(within, rules, frozenset(named))


class _HolderSearch(Data):
    """Finds subjects with a permission.

    Attributes:
        policy: the policy.
        kind: kind of the objects.
        permission: the permission.
        name: pattern of the objects.
        budget: limit of the search.
    """

    policy: LoadedPolicy
    kind: str
    permission: str
    name: Glob
    budget: QueryBudget = field(default_factory=QueryBudget)

    def holder(self, subject: str, like: str = "") -> Iterator[PermissionHolder]:
        """Yield a subject if it has, or may have, the permission."""
        rules = rules_of(self.policy, subject)
        outcome = self._shortest_granted(rules)
        if isinstance(outcome, Unknown):
            yield PermissionHolder(subject, like, "", None, outcome.reason)
        elif isinstance(outcome, Witness):
            rule = matching_rule(rules, Effect.ALLOW, self.kind, self.permission, outcome.word)
            yield PermissionHolder(subject, like, outcome.word, rule.origin if rule else None)

    def _shortest_granted(self, rules: Sequence[Rule], budget: QueryBudget | None = None) -> ProofResult:
        """Find the shortest of the names on which rules grant the permission."""
        lists = part_lists(rules, self.kind, self.permission)
        limit = budget.next_query(len(lists)) if budget else None
        return find_permitted(self.kind, allow_only(self.name), *lists, budget=limit)

    def others(self, within: Glob, rules: SymbolicRules, named: frozenset[str]) -> Iterator[PermissionHolder]:
        """Yield an example for each pattern of subjects with the permission, other than the named subjects."""
        (kind, part, suffix), *_ = parts(self.kind, self.permission)
        reported: set[Glob] = set()
        unknown: dict[Glob, str] = {}
        for rule in rules.all((kind, part), Effect.ALLOW).values():
            for subjects in (piece for one in rule.reach.subjects for piece in overlap(one, within)):
                if subjects in reported:
                    continue
                excluded = [(subject,) for subject in sorted(named) if matches(subjects, subject)]
                some, none = self._conditions(rules, subjects)
                some = [*rule.reach.conditions, *some]
                for shape in right_quotient(rule.object, suffix):
                    answer = find_subject(self.kind, subjects, shape, some, none, self._check, excluded, self.budget)
                    if isinstance(answer, Unknown):
                        unknown.setdefault(subjects, answer.reason)
                    elif answer is not None:
                        reported.add(subjects)
                        yield from self.holder(answer, pattern_text(subjects))
                        break
        for subjects, reason in unknown.items():
            if subjects not in reported:
                yield PermissionHolder("", pattern_text(subjects), "", None, reason)

    def _conditions(self, rules: SymbolicRules, subjects: Glob) -> tuple[list[Entries], Entries]:
        """Return the entries of which a word matches some, and none; a composite permission requires all its parts."""
        some: list[Entries] = [(SymbolicEntry((EVERYBODY,), self.name),)]
        none: list[SymbolicEntry] = []
        for number, (kind, part, suffix) in enumerate(parts(self.kind, self.permission)):
            key = (kind, part)
            none += _without(rules.surely(key, Effect.DENY, subjects), suffix)
            if number:
                # Over-approximated where they are too complex.
                entries = [rule.entry() for rule in rules.applying(key, Effect.ALLOW, subjects)]
                some.append(tuple(_without(entries, suffix)))
        return some, tuple(none)

    def _check(self, subject: str) -> bool | Unknown:
        return self.budget.verdict(self._shortest_granted(rules_of(self.policy, subject), self.budget))


def _without(entries: Sequence[SymbolicEntry], suffix: str) -> Iterator[SymbolicEntry]:
    for entry in entries:
        yield from (SymbolicEntry(entry.subjects, pattern) for pattern in right_quotient(entry.object, suffix))


def effective_permissions(rules: Sequence[Rule]) -> Iterator[tuple[Rule, str, str, tuple[str, ...]]]:
    """Yield the permissions by ALLOW rules that DENY rules do not deny completely.

    Args:
        rules: the rules of a subject.

    Yields:
        A rule, one of its permissions, one of its expressions, and the expressions of DENY rules that deny a part.
    """
    denials = [rule for rule in rules if rule.effect is Effect.DENY]
    for rule in rules:
        if rule.effect is not Effect.ALLOW:
            continue
        for permission in rule.permissions:
            lists = part_lists(rules, rule.kind, permission)
            for expression in rule.expressions:
                words = [query_pattern(rule.kind, expression, partition) for partition in rule.partitions or ("",)]
                if all(isinstance(find_permitted(rule.kind, allow_only(one), *lists), Equal) for one in words):
                    continue
                yield rule, permission, expression, _denied_expressions(rule, expression, permission, denials)


def _denied_expressions(rule: Rule, expression: str, permission: str, denials: Sequence[Rule]) -> tuple[str, ...]:
    keys = [(kind, part) for kind, part, _ in parts(rule.kind, permission)]
    return tuple(
        dict.fromkeys(
            denied + "".join(f" in partition {each!r}" for each in denial.partitions)
            for denial in denials
            for denied in denial.expressions
            for key in keys
            if any(
                not disjoint(one, other)
                for one in rule_patterns(rule, expression, key)
                for other in rule_patterns(denial, denied, key)
            )
        )
    )
