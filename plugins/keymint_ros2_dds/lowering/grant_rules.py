# SPDX-License-Identifier: Apache-2.0
"""Rules of a grant: the decision list that a permissions document holds (DDS Security 1.1, 9.4.1.3.2.3)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import chain
from typing import Generic, TypeVar

from comarmor.patterns.tokens import SPECIAL
from comarmor.rules import Effect
from comarmor.values import dataclass
from keymint_ros2_dds.lowering.dds_topics import TopicAction

Partitions = tuple[str, ...]
"""Partition expressions, sorted."""
DEFAULT: Partitions = ("",)
"""The default partition."""
EVERY: Partitions = ("*",)

_Pattern = TypeVar("_Pattern")


@dataclass(frozen=True, slots=True)
class GrantRule(Generic[_Pattern]):
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
