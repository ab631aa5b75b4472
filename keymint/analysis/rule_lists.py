"""Rules as decision lists of the proof engine, one for each kind and permission that has no parts.

A word is the name of an object; for kind ``topic`` it is a partition, NUL and the name of the DDS topic. An endpoint in
several partitions is allowed when it is in each of them, so that one partition at a time says all.
"""

from __future__ import annotations

import string
from collections.abc import Iterable, Iterator
from functools import lru_cache

from comarmor.patterns.decision_lists import Block, DecisionList, ProofResult, SearchBudget, Universe
from comarmor.patterns.glob import EVERYTHING, Glob, after, literal, normalise, parse, surround, units
from comarmor.patterns.printing import exact
from comarmor.patterns.proofs import difference
from comarmor.patterns.tokens import ANY, MAX_CODE, STAR, charset
from comarmor.rules import PARTS, Effect, parts
from keymint.ir import Rule

RAW = "topic"
SEPARATOR = "\0"
PermissionKey = tuple[str, str]
"""A kind, and a permission of it that has no parts."""

_ROS = Universe(charset((ord(char), ord(char)) for char in string.ascii_letters + string.digits + "_/"))
_RAW = Universe(charset(((ord(" "), MAX_CODE),)), fields=2, separator=SEPARATOR)
_ROS_NAMES: DecisionList = (
    Block(False, tuple(map(parse, ("*//*", "*/", "*/[0-9]*")))),
    Block(True, (parse("/?*"),)),
)
_RAW_NAMES: DecisionList = (Block(True, (normalise((STAR, SEPARATOR, ANY, STAR)),)),)


def universe(kind: str) -> Universe:
    """Return the words that a question about a kind is about."""
    return _RAW if kind == RAW else _ROS


def names(kind: str) -> DecisionList:
    """Return what permits the names that an object of a kind can have (ROS 2 design, "Topic and Service name mapping").

    A fully qualified ROS name is made of segments of letters, digits and ``_`` that do not begin with a digit, each
    after a ``/``; a DDS topic has any name that is not empty.
    """
    return _RAW_NAMES if kind == RAW else _ROS_NAMES


def keys(rule: Rule) -> Iterator[PermissionKey]:
    """Yield what a rule is about, its permissions taken apart."""
    yield from dict.fromkeys((kind, part) for held in rule.permissions for kind, part, _ in parts(rule.kind, held))


def patterns(rule: Rule, expression: str, key: PermissionKey) -> tuple[Glob, ...]:
    """Return the words of a kind and permission that an expression of a rule is about."""
    parsed = parse(expression)
    if rule.kind == RAW:
        if key not in keys(rule):
            return ()
        default = ("*",) if rule.effect is Effect.DENY else ("",)
        return tuple(in_partition(partition, parsed) for partition in rule.partitions or default)
    return tuple(
        surround("", parsed, suffix)
        for held in rule.permissions
        for kind, part, suffix in parts(rule.kind, held)
        if (kind, part) == key
    )


def in_partition(partition: str, name: Glob) -> Glob:
    """Return the words of a DDS topic in the partitions that an expression matches."""
    return normalise((*parse(partition), SEPARATOR, *name))


def asked(kind: str, expression: str, partition: str = "") -> Glob:
    """Return the words that a question for names is about."""
    return in_partition(partition, parse(expression)) if kind == RAW else parse(expression)


def listed(rules: Iterable[Rule], key: PermissionKey) -> DecisionList:
    """Return what rules say of a kind and permission that has no parts: denials, then what is allowed."""
    found: dict[Effect, dict[Glob, None]] = {Effect.DENY: {}, Effect.ALLOW: {}}
    for rule in rules:
        for expression in rule.expressions:
            found[rule.effect] |= dict.fromkeys(patterns(rule, expression, key))
    return decisions(found[Effect.DENY], found[Effect.ALLOW])


def decisions(denied: Iterable[Glob], allowed: Iterable[Glob]) -> DecisionList:
    """Return the decision list of denials that override what is allowed."""
    return (Block(False, tuple(denied)), Block(True, tuple(allowed)))


def part_lists(rules: Iterable[Rule], kind: str, permission: str) -> tuple[DecisionList, ...]:
    """Return lists of which all must permit a name for the permission to be held: one for each part."""
    rules = tuple(rules)
    return tuple(
        without(listed(rules, (part_kind, part)), suffix) for part_kind, part, suffix in parts(kind, permission)
    )


def without(decided: DecisionList, suffix: str) -> DecisionList:
    """Return what a list says of ``name + suffix``, as a list about the name."""
    if not suffix:
        return decided
    return tuple(
        Block(block.allows, tuple(left for pattern in block.patterns for left in _before(pattern, suffix)))
        for block in decided
    )


@lru_cache(maxsize=1 << 14)
def _before(pattern: Glob, suffix: str) -> tuple[Glob, ...]:
    text = literal(pattern)
    if text is not None:
        left = text.removesuffix(suffix)
        return () if left == text else ((left,) if left else (),)
    backwards = normalise(reversed(units(pattern)))
    return tuple(normalise(reversed(units(left))) for left in after(backwards, suffix[::-1]))


def allowed(pattern: Glob) -> DecisionList:
    """Return what permits the words that a pattern matches, and no others."""
    return (Block(True, (pattern,)),)


def negated(decided: DecisionList) -> DecisionList:
    """Return the list that permits exactly what another one refuses."""
    return (*(Block(not block.allows, block.patterns) for block in decided), Block(True, (EVERYTHING,)))


def meet(kind: str, *lists: DecisionList, budget: SearchBudget | None = None) -> ProofResult:
    """Tell whether there is a legal name that all of some lists permit.

    Args:
        kind: kind of the objects.
        lists: the lists.
        budget: what the answer may cost.

    Returns:
        a shortest ``Witness`` if so; else ``Equal`` (there is none), or ``Unknown``.
    """
    return difference((), *lists, names(kind), universe=universe(kind), budget=budget)


def is_composite(kind: str, permission: str) -> bool:
    """Tell whether a permission is a shorthand for several."""
    return (kind, permission) in PARTS


def text(pattern: Glob) -> str:
    """Return a pattern as an expression."""
    return exact(pattern, unescaped="_/.")


def shown(kind: str, pattern: Glob) -> str:
    """Return a pattern for a person: the expression of the name, and of the partition if it is not the default one."""
    if kind != RAW:
        return text(pattern)
    flat = units(pattern)
    at = flat.index(SEPARATOR)
    partition, name = text(normalise(flat[:at])), text(normalise(flat[at + 1 :]))
    return f"{name} in partition {partition!r}" if partition else name


def word(kind: str, found: str) -> str:
    """Return a word for a person: the name, and the partition if it is not the default one."""
    partition, _, name = found.rpartition(SEPARATOR)
    return f"{name} in partition {partition!r}" if kind == RAW and partition else name
