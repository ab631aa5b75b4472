# SPDX-License-Identifier: Apache-2.0
"""Rules in terms of DDS: the topic patterns that each rule of a subject allows or denies, and the rules of a grant.

The lowered rules have no order yet: deny overrides allow. The rules of a grant are the decision list that a permissions
document holds (DDS Security 1.1, 9.4.1.3.2.3).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from itertools import chain
from typing import Generic, TypeVar

from comarmor.patterns import glob
from comarmor.patterns.expression import exact
from comarmor.patterns.glob import Glob
from comarmor.patterns.possible_names import advice, matches_ros_name
from comarmor.patterns.tokens import SPECIAL
from comarmor.rules import Effect
from comarmor.text import did_you_mean
from comarmor.values import Data
from keymint.errors import Diagnostic, KeymintError, require_none
from keymint.ir import Rule, SubjectRules
from keymint_ros2_dds.lowering import name_mapping
from keymint_ros2_dds.lowering.name_mapping import (
    TOPIC_ACTIONS,
    TopicAction,
    dds_patterns,
    has_kind,
    needed_topics,
    parse_expression,
)

Partitions = tuple[str, ...]
"""Partition expressions, sorted."""
DEFAULT: Partitions = ("",)
"""The default partition."""
EVERY: Partitions = ("*",)

_Pattern = TypeVar("_Pattern")


class GrantRule(Data, Generic[_Pattern]):
    """An ``<allow_rule>`` or ``<deny_rule>``: over patterns while it is compiled, over expressions when it is written.

    Attributes:
        effect: allow or deny.
        partitions: partition expressions that all its criteria share.
        topics: topic patterns, or topic expressions, by action.
    """

    effect: Effect
    partitions: Partitions
    topics: Mapping[TopicAction, tuple[_Pattern, ...]]

    def every_topic(self) -> Iterator[_Pattern]:
        """Return the topics of all actions."""
        return chain.from_iterable(self.topics.values())


def with_leading_allow(rules: Sequence[GrantRule[_Pattern]]) -> tuple[GrantRule[_Pattern], ...]:
    """Return rules that begin with an allow rule: with one without criteria, if the first one denies."""
    empty: GrantRule[_Pattern] = GrantRule(Effect.ALLOW, DEFAULT, {})
    return (empty, *rules) if rules and rules[0].effect is Effect.DENY else tuple(rules)


def is_name(expression: str) -> bool:
    """Return whether an expression matches only the topic of that name, in every dialect."""
    return not SPECIAL.search(expression)


LoweredRules = Mapping[tuple[Glob, Partitions], Rule]
"""Topic patterns with their partitions (none: not narrowed), and for each the first rule that has it."""

_RAW_TOPIC = "topic"
"""The kind of rules on DDS topics by their own names."""


class Lowered(Data):
    """The rules of a subject as DDS patterns, by action.

    Attributes:
        allow: the patterns that ALLOW rules match.
        deny: the patterns that DENY rules match.
        diagnostics: warnings about expressions that match no name.
    """

    allow: Mapping[TopicAction, LoweredRules]
    deny: Mapping[TopicAction, LoweredRules]
    diagnostics: tuple[Diagnostic, ...]

    def patterns(self) -> Iterator[tuple[Effect, TopicAction, Glob, Rule]]:
        """Yield every pattern with its rule, those of ALLOW rules first."""
        for effect, sides in ((Effect.ALLOW, self.allow), (Effect.DENY, self.deny)):
            for action in TOPIC_ACTIONS:
                for (pattern, _), rule in sides[action].items():
                    yield effect, action, pattern, rule


def lower(rules: SubjectRules, distro: str) -> Lowered:
    """Return the DDS patterns of a subject's rules.

    Args:
        rules: the rules.
        distro: ROS 2 distribution whose name mapping applies.

    Raises:
        KeymintError: an expression is invalid, or the distribution has no such entities; with ``file:line``.
    """
    require_none(_unknown(rule, distro, rules.subject) for rule in rules.rules if not has_kind(distro, rule.kind))
    sides: dict[Effect, dict[TopicAction, dict[tuple[Glob, Partitions], Rule]]] = {
        effect: {action: {} for action in TOPIC_ACTIONS} for effect in Effect
    }
    diagnostics: list[Diagnostic] = []
    for rule in rules.rules:
        side = sides[rule.effect]
        partitions = tuple(sorted(set(rule.partitions)))
        for expression in partitions:
            parse_expression(expression, rule.origin)
        for expression in rule.expressions:
            tokens = parse_expression(expression, rule.origin)
            try:
                patterns = _patterns(tokens, rule.kind, rule.permissions, rule.effect, distro)
            except KeyError as error:
                message = f"DDS knows no permission {error.args[0]!r} of a {rule.kind} rule"
                help_ = did_you_mean(error.args[0], name_mapping.DDS_TOPICS)
                raise KeymintError(message, where=rule.origin, help=help_, code="permission-unknown") from None
            for action, pattern, partition in patterns:
                side[action].setdefault((pattern, partition or partitions), rule)
            if not patterns or not (rule.kind == _RAW_TOPIC or matches_ros_name(tokens)):
                diagnostics.append(_never_matches(expression, rule, rules.subject))
    return Lowered(sides[Effect.ALLOW], sides[Effect.DENY], tuple(diagnostics))


# Subjects of a fleet share most expressions, and a subject's rules are lowered for several purposes.
@lru_cache(maxsize=1 << 14)
def _patterns(
    tokens: Glob, kind: str, permissions: tuple[str, ...], effect: Effect, distro: str
) -> tuple[tuple[TopicAction, Glob, Partitions], ...]:
    """Return action, topic pattern and mapped partitions of an expression of a rule, for all its permissions."""
    return tuple(
        (topic.action, pattern, () if partition is None else (exact(partition),))
        for topic, suffix in needed_topics(kind, permissions)
        for pattern, partition in dds_patterns(distro, tokens, topic, suffix, effect)
        if pattern and not glob.is_empty(pattern) and not (partition and glob.is_empty(partition))
    )


def _unknown(rule: Rule, distro: str, subject: str) -> Diagnostic:
    message = f"ROS 2 {distro.capitalize()} has no actions, but this is an {rule.effect} {rule.kind} rule"
    return Diagnostic.error("distro-kind", message, rule.origin, "remove it, or take a later distro", subject)


def _never_matches(expression: str, rule: Rule, subject: str) -> Diagnostic:
    raw = rule.kind == _RAW_TOPIC
    why = f"no {'DDS topic' if raw else 'ROS object'} can have such a name"
    message = f"the expression {expression!r} of this {rule.effect} {rule.kind} rule matches no name: {why}"
    help_ = "remove it" if raw or not expression else advice(expression)
    return Diagnostic.warning("never-matches", message, rule.origin, help_, subject)
