# SPDX-License-Identifier: Apache-2.0
"""List the effective permissions of a subject: what its ALLOW rules allow after its DENY rules."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from comarmor.errors import Origin
from comarmor.patterns.decision_lists import Equal
from comarmor.patterns.relations import disjoint
from comarmor.rules import Effect, parts
from comarmor.values import dataclass
from keymint.analysis.rule_lists import allow_only, find_permitted, part_lists, query_pattern, rule_patterns
from keymint.ir import Rule


@dataclass(frozen=True, slots=True)
class EffectivePermission:
    """A permission that a subject has on objects that match an expression.

    Attributes:
        permission: the permission.
        expression: the expression of the rule.
        partitions: partitions of the rule.
        but: expressions of DENY rules that deny a part of it.
        audit: the rule asks for monitoring.
        where: the rule.
    """

    permission: str
    expression: str
    partitions: tuple[str, ...]
    but: tuple[str, ...]
    audit: bool
    where: Origin


def effective_permissions(rules: Sequence[Rule]) -> Iterator[EffectivePermission]:
    """Yield the permissions by ALLOW rules that DENY rules do not deny completely."""
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
                but = _denied_expressions(rule, expression, permission, denials)
                yield EffectivePermission(permission, expression, rule.partitions, but, rule.audit, rule.origin)


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
