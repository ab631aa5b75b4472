# SPDX-License-Identifier: Apache-2.0
"""Convert rules to decision lists of the proof engine, one for each kind and permission without parts.

A word is the name of an object; for kind ``topic`` it is a partition, NUL and the name of the raw topic. An endpoint in
several partitions is allowed if it is allowed in each of them, so deciding one partition at a time is enough.
"""

from __future__ import annotations

import string
from collections.abc import Iterable, Iterator, Sequence
from functools import cached_property, lru_cache
from itertools import count
from operator import itemgetter

from comarmor.patterns.decision_lists import Block, DecisionList, Equal, ProofResult, SearchBudget, Universe
from comarmor.patterns.expression import exact, rule_matches, rule_matches_partition
from comarmor.patterns.glob import Glob, normalise, parse, right_quotient, surround, units
from comarmor.patterns.pattern_index import PatternIndex
from comarmor.patterns.possible_names import matches_ros_name
from comarmor.patterns.proofs import difference
from comarmor.patterns.relations import TooComplexError, disjoint, intersection
from comarmor.patterns.tokens import ANY, MAX_CODE, STAR, charset
from comarmor.rules import Effect, parts, suffixes
from keymint.ir import Rule

RAW = "topic"
SEPARATOR = "\0"
PermissionKey = tuple[str, str]
"""A kind, and a permission of it without parts."""

_ROS = Universe(charset((ord(char), ord(char)) for char in string.ascii_letters + string.digits + "_/"))
_RAW = Universe(charset(((ord(" "), MAX_CODE),)), fields=2, separator=SEPARATOR)
_ROS_NAMES: DecisionList = (
    Block(False, tuple(map(parse, ("*//*", "*/", "*/[0-9]*")))),
    Block(True, (parse("/?*"),)),
)
_RAW_NAMES: DecisionList = (Block(True, (normalise((STAR, SEPARATOR, ANY, STAR)),)),)


def universe(kind: str) -> Universe:
    """Return the words of a kind."""
    return _RAW if kind == RAW else _ROS


def legal_names(kind: str) -> DecisionList:
    """Return the decision list of the legal names of a kind (ROS 2 design, "Topic and Service name mapping").

    A fully qualified ROS name consists of segments of letters, digits and ``_`` that do not begin with a digit, each
    after a ``/``. A raw topic has any nonempty name.
    """
    return _RAW_NAMES if kind == RAW else _ROS_NAMES


def permission_keys(rule: Rule) -> tuple[PermissionKey, ...]:
    """Return the kinds and permissions of a rule, with composite permissions replaced by their parts."""
    return _keys(rule.kind, tuple(rule.permissions))


@lru_cache
def _keys(kind: str, permissions: tuple[str, ...]) -> tuple[PermissionKey, ...]:
    found = ((part_kind, part) for each in permissions for part_kind, part, _ in parts(kind, each))
    return tuple(dict.fromkeys(found))


def part_patterns(kind: str, permission: str, objects: Glob) -> Iterator[tuple[PermissionKey, Glob]]:
    """Yield the permissions without parts, each with a pattern of its words, that make up a permission on objects."""
    for part_kind, part, suffix in parts(kind, permission):
        yield (part_kind, part), surround("", objects, suffix)


def rule_patterns(rule: Rule, expression: str, key: PermissionKey) -> tuple[Glob, ...]:
    """Return patterns of the words of a kind and permission that an expression of a rule matches."""
    parsed = parse(expression)
    endings = suffixes(rule, *key)
    if rule.kind == RAW:
        partitions = rule.partitions or (("*",) if rule.effect is Effect.DENY else ("",))
        return tuple(in_partition(partition, parsed) for _ in endings for partition in partitions)
    return tuple(surround("", parsed, suffix) for suffix in endings)


def object_patterns(rule: Rule, key: PermissionKey) -> Iterator[Glob]:
    """Yield the patterns of the words of a kind and permission that a rule matches."""
    for expression in rule.expressions:
        yield from rule_patterns(rule, expression, key)


def matching_rule(rules: Sequence[Rule], effect: Effect, kind: str, permission: str, word: str) -> Rule | None:
    """Return the first rule of an effect for a name, by the first part of a composite permission that has one."""
    partition, _, name = word.rpartition(SEPARATOR)
    near = [rule for rule in rules if rule.effect is effect and rule_matches_partition(rule, partition)]
    matching = (
        rule
        for part_kind, part, suffix in parts(kind, permission)
        for rule in near
        if rule_matches(rule, part_kind, part, name + suffix)
    )
    return next(matching, None)


def in_partition(partition: str, name: Glob) -> Glob:
    """Return the pattern of a raw topic in the partitions that an expression matches."""
    return normalise((*parse(partition), SEPARATOR, *name))


def query_pattern(kind: str, expression: str, partition: str = "") -> Glob:
    """Return the pattern of words for an expression in a query."""
    return in_partition(partition, parse(expression)) if kind == RAW else parse(expression)


def decision_list(rules: Iterable[Rule], key: PermissionKey) -> DecisionList:
    """Return the decision list of rules for a kind and permission without parts."""
    by_effect: dict[Effect, dict[Glob, None]] = {Effect.DENY: {}, Effect.ALLOW: {}}
    for rule in rules:
        by_effect[rule.effect] |= dict.fromkeys(object_patterns(rule, key))
    return deny_over_allow(by_effect[Effect.DENY], by_effect[Effect.ALLOW])


class ListComparison:
    """Two decision lists, as :func:`decision_list` returns them, of whose many patterns few concern a given one.

    Args:
        old: the older list.
        new: the newer one.
    """

    def __init__(self, old: DecisionList, new: DecisionList) -> None:
        (denied, allowed), (still_denied, _) = ([*map(set, (block.patterns for block in side))] for side in (old, new))
        self._allowed, self._lifted = allowed, denied - still_denied
        self._lists = (old, new)

    @cached_property
    def _sides(self) -> list[list[tuple[Block, PatternIndex[int]]]]:
        """The blocks of both lists, with the numbers of their patterns; few comparisons need them."""
        return [[(block, PatternIndex(zip(block.patterns, count()))) for block in side] for side in self._lists]

    def may_gain(self, pattern: Glob) -> bool:
        """Return False if the older list surely allows all of a pattern that the newer one allows.

        It does if it has the same pattern, and no denial that only it has concerns that.
        """
        return pattern not in self._allowed or not all(disjoint(pattern, each) for each in self._lifted)

    def near(self, pattern: Glob) -> list[DecisionList]:
        """Return both lists, in their order, without patterns that surely have no word in common with a pattern."""
        met = [
            [(block, sorted(index.candidates(pattern), key=itemgetter(1))) for block, index in side]
            for side in self._sides
        ]
        return [tuple(Block(block.allows, tuple(each for each, _ in found)) for block, found in side) for side in met]


def deny_over_allow(denied: Iterable[Glob], allowed: Iterable[Glob]) -> DecisionList:
    """Return the decision list in which denied patterns override allowed ones."""
    return (Block(False, tuple(denied)), Block(True, tuple(allowed)))


def part_lists(rules: Sequence[Rule], kind: str, permission: str) -> tuple[DecisionList, ...]:
    """Return a decision list for each part of a permission; the permission requires all of them."""
    return tuple(
        strip_suffix(decision_list(rules, (part_kind, part)), suffix)
        for part_kind, part, suffix in parts(kind, permission)
    )


def strip_suffix(decided: DecisionList, suffix: str) -> DecisionList:
    """Return the list of names for which a list decides on ``name + suffix``."""
    if not suffix:
        return decided
    return tuple(
        Block(block.allows, tuple(left for pattern in block.patterns for left in right_quotient(pattern, suffix)))
        for block in decided
    )


def allow_only(pattern: Glob) -> DecisionList:
    """Return the list that allows exactly the words that a pattern matches."""
    return (Block(True, (pattern,)),)


def restrict_allowed(pattern: Glob, decided: DecisionList) -> DecisionList:
    """Return a decision list restricted to one of its allowed patterns."""
    return (*(block for block in decided if not block.allows), Block(True, (pattern,)))


def find_permitted(kind: str, *lists: DecisionList, budget: SearchBudget | None = None) -> ProofResult:
    """Find a legal name that all lists allow.

    Args:
        kind: kind of the objects.
        lists: the lists.
        budget: limit of the search.

    Returns:
        A shortest ``Witness``, ``Equal`` if there is none, or ``Unknown``.
    """
    return difference((), *lists, legal_names(kind), universe=universe(kind), budget=budget)


def is_possible(kind: str, pattern: Glob) -> bool:
    """Return True unless no legal name of a kind matches a pattern."""
    if kind != RAW:
        return matches_ros_name(pattern)
    return not isinstance(find_permitted(kind, allow_only(pattern)), Equal)


def overlap(one: Glob, other: Glob) -> tuple[Glob, ...]:
    """Return patterns of the words that two patterns match, or the first one if they are too complex."""
    try:
        return intersection(one, other)
    except TooComplexError:
        return (one,)


def pattern_text(pattern: Glob) -> str:
    """Return a pattern as an expression."""
    return exact(pattern, unescaped="_/.")


def display_pattern(kind: str, pattern: Glob) -> str:
    """Return a pattern as display text: the expression of the name, and the partition if it is not the default."""
    if kind != RAW:
        return pattern_text(pattern)
    flat = units(pattern)
    at = flat.index(SEPARATOR)
    partition, name = pattern_text(normalise(flat[:at])), pattern_text(normalise(flat[at + 1 :]))
    return f"{name} in partition {partition!r}" if partition else name


def display_name(kind: str, word: str) -> str:
    """Return a word as display text: the name, and the partition if it is not the default."""
    partition, _, name = word.rpartition(SEPARATOR)
    return f"{name} in partition {partition!r}" if kind == RAW and partition else name
