"""What a subject can do: its rules, read as what is left of them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from comarmor.errors import Origin
from comarmor.patterns.decision_lists import Equal
from comarmor.patterns.glob import parse
from comarmor.patterns.relations import disjoint
from comarmor.rules import Effect, parts
from keymint.analysis.rule_lists import RAW, allowed, in_partition, meet, part_lists, patterns
from keymint.ir import Rule


@dataclass(frozen=True, slots=True)
class EffectivePermission:
    """A permission that a subject has on what an expression matches.

    Attributes:
        permission: the permission.
        expression: the expression of the rule.
        partitions: DDS partitions, as the rule has them.
        but: expressions of DENY rules that take some of it away.
        audit: it is to be watched.
        where: the rule.
    """

    permission: str
    expression: str
    partitions: tuple[str, ...]
    but: tuple[str, ...]
    audit: bool
    where: Origin


def effective_permissions(rules: Sequence[Rule]) -> Iterator[EffectivePermission]:
    """Yield what rules allow of which anything is left."""
    denials = [rule for rule in rules if rule.effect is Effect.DENY]
    for rule in rules:
        if rule.effect is not Effect.ALLOW:
            continue
        for permission in rule.permissions:
            lists = part_lists(rules, rule.kind, permission)
            for expression in rule.expressions:
                asked = [parse(expression)]
                if rule.kind == RAW:
                    asked = [in_partition(each, asked[0]) for each in rule.partitions or ("",)]
                if all(isinstance(meet(rule.kind, allowed(one), *lists), Equal) for one in asked):
                    continue
                but = _taken(rule, expression, permission, denials)
                yield EffectivePermission(permission, expression, rule.partitions, but, rule.audit, rule.origin)


def _taken(rule: Rule, expression: str, permission: str, denials: Sequence[Rule]) -> tuple[str, ...]:
    keys = [(kind, part) for kind, part, _ in parts(rule.kind, permission)]
    return tuple(
        dict.fromkeys(
            theirs + "".join(f" in partition {each!r}" for each in denial.partitions)
            for denial in denials
            for theirs in denial.expressions
            for key in keys
            if any(
                not disjoint(one, other)
                for one in patterns(rule, expression, key)
                for other in patterns(denial, theirs, key)
            )
        )
    )
