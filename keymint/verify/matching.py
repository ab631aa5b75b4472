"""Which rules of the intermediate representation are about an edge, and which come near."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache

from comarmor.patterns import glob
from comarmor.patterns.matching import matcher
from comarmor.rules import Effect, parts
from comarmor.text import nearest_word
from keymint.graph import Edge
from keymint.ir import Rule
from keymint.verify.endpoint_policy import RAW


@lru_cache(maxsize=1 << 12)
def _matches(expression: str, name: str) -> bool:
    return matcher(glob.parse(expression))(name)


def about(rules: Sequence[Rule], edge: Edge) -> tuple[int, ...]:
    """Return the positions of the rules that match an edge itself, or a part of it, deny first."""
    wanted = parts(edge.object.kind, edge.permission)
    found = [at for at, rule in enumerate(rules) if any(_is_about(rule, part, edge) for part in wanted)]
    return tuple(sorted(found, key=lambda at: rules[at].effect is Effect.ALLOW))


def _is_about(rule: Rule, part: tuple[str, str, str], edge: Edge) -> bool:
    """Tell whether a rule, itself or as what its composite permissions stand for, is about a part of an edge."""
    kind, permission, suffix = part
    name = edge.object.name + suffix
    for held in rule.permissions:
        for kind_of_part, permission_of_part, tail in parts(rule.kind, held):
            if (kind_of_part, permission_of_part) != (kind, permission) or not name.endswith(tail):
                continue
            stem = name.removesuffix(tail)
            if any(_matches(each, stem) for each in rule.expressions) and _in_partitions(rule, edge):
                return True
    return False


def _in_partitions(rule: Rule, edge: Edge) -> bool:
    asked = edge.object.partitions or ("",)
    if not rule.partitions:
        return rule.effect is Effect.DENY or "" in asked
    return any(_matches(each, name) for each in rule.partitions for name in asked)


@dataclass(frozen=True, slots=True)
class NearMiss:
    """A rule that nearly matches: its position, and what it lacks in words."""

    at: int
    lacks: str


def nearest(rules: Sequence[Rule], edge: Edge) -> NearMiss | None:
    """Return the rule that comes nearest to allowing an edge, or None when none does.

    One that names the object with another permission is nearer than one whose name is only similar.
    """
    allows = [(at, rule) for at, rule in enumerate(rules) if rule.effect is Effect.ALLOW]
    candidates: Iterator[NearMiss | None] = (
        finder(allows, edge) for finder in (_other_partition, _other_permission, _other_kind, _similar_name)
    )
    return next((found for found in candidates if found), None)


def _names(rule: Rule, edge: Edge) -> bool:
    return any(_matches(each, edge.object.name) for each in rule.expressions)


def _other_partition(allows: Sequence[tuple[int, Rule]], edge: Edge) -> NearMiss | None:
    for at, rule in allows:
        if edge.object.kind == rule.kind == RAW and edge.permission in rule.permissions and _names(rule, edge):
            where = ", ".join(map(repr, rule.partitions)) or "the default partition only"
            return NearMiss(at, f"it is about {'' if not rule.partitions else 'partitions '}{where}")
    return None


def _other_permission(allows: Sequence[tuple[int, Rule]], edge: Edge) -> NearMiss | None:
    for at, rule in allows:
        if rule.kind == edge.object.kind and edge.permission not in rule.permissions and _names(rule, edge):
            return NearMiss(at, f"it allows {', '.join(rule.permissions)}, not {edge.permission}")
    return None


def _other_kind(allows: Sequence[tuple[int, Rule]], edge: Edge) -> NearMiss | None:
    for at, rule in allows:
        literal = any(glob.literal(glob.parse(each)) == edge.object.name for each in rule.expressions)
        if rule.kind != edge.object.kind and literal:
            return NearMiss(at, f"it is a {rule.kind} rule, and {edge.permission} is about a {edge.object.kind}")
    return None


def _similar_name(allows: Sequence[tuple[int, Rule]], edge: Edge) -> NearMiss | None:
    by_expression = {
        each: at
        for at, rule in reversed(allows)
        if rule.kind == edge.object.kind and edge.permission in rule.permissions
        for each in rule.expressions
    }
    near = nearest_word(edge.object.name, by_expression)
    return NearMiss(by_expression[near], f"it is about {near!r}; did you mean that?") if near else None
