# SPDX-License-Identifier: Apache-2.0
"""The rules that apply to an edge, and the rule that nearly does."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from comarmor.errors import Origin
from comarmor.patterns import glob
from comarmor.patterns.expression import matches, rule_matches, rule_matches_partition
from comarmor.rules import Effect, parts
from comarmor.text import nearest_word
from comarmor.values import dataclass
from keymint.api.graph import Edge
from keymint.ir import Rule
from keymint.verify.rows import RAW


def matching_rules(rules: Sequence[Rule], edges: Iterable[Edge]) -> list[int]:
    """Return the positions of the rules that apply to any of some edges or to a part of it, DENY rules first."""
    positions = {at for edge in edges for at, rule in enumerate(rules) if _applies(rule, edge)}
    return sorted(positions, key=lambda at: (rules[at].effect is Effect.ALLOW, at))


def _applies(rule: Rule, edge: Edge) -> bool:
    return any(
        rule_matches(rule, kind, permission, edge.object.name + suffix)
        for kind, permission, suffix in parts(edge.object.kind, edge.permission)
    ) and any(rule_matches_partition(rule, partition) for partition in edge.object.partitions or ("",))


@dataclass(frozen=True, slots=True)
class MatchedRule:
    """A rule that applies to a request, its place, and a note if it only nearly applies."""

    rule: Rule
    where: Origin
    note: str = ""


def nearest(rules: Sequence[Rule], edge: Edge) -> MatchedRule | None:
    """Return the ALLOW rule that comes nearest to an edge, with the difference in words, or None.

    The same object with another permission is nearer than an object with a similar name.
    """
    allows = [rule for rule in rules if rule.effect is Effect.ALLOW]
    for lack in (_other_partition, _other_permission, _other_kind):
        for rule in allows:
            if lacks := lack(rule, edge):
                return MatchedRule(rule, rule.origin, lacks)
    return _similar_name(allows, edge)


def _names(rule: Rule, edge: Edge) -> bool:
    return any(matches(each, edge.object.name) for each in rule.expressions)


def _other_partition(rule: Rule, edge: Edge) -> str:
    if not (edge.object.kind == rule.kind == RAW and edge.permission in rule.permissions and _names(rule, edge)):
        return ""
    partitions = f"partitions {', '.join(map(repr, rule.partitions))}"
    return f"it applies to {partitions if rule.partitions else 'the default partition only'}"


def _other_permission(rule: Rule, edge: Edge) -> str:
    if rule.kind == edge.object.kind and edge.permission not in rule.permissions and _names(rule, edge):
        return f"it allows {', '.join(rule.permissions)}, not {edge.permission}"
    return ""


def _other_kind(rule: Rule, edge: Edge) -> str:
    literal = any(glob.literal(glob.parse(each)) == edge.object.name for each in rule.expressions)
    if literal and rule.kind != edge.object.kind:
        return f"it is a {rule.kind} rule, and {edge.permission} is a permission of {edge.object.kind}"
    return ""


def _similar_name(allows: Sequence[Rule], edge: Edge) -> MatchedRule | None:
    by_expression = {
        each: rule
        for rule in reversed(allows)
        if rule.kind == edge.object.kind and edge.permission in rule.permissions
        for each in rule.expressions
    }
    near = nearest_word(edge.object.name, by_expression)
    if not near:
        return None
    return MatchedRule(by_expression[near], by_expression[near].origin, f"it applies to {near!r}; did you mean that?")
