# SPDX-License-Identifier: Apache-2.0
"""Moves rules and expressions that are requested more often to the front, where that changes no decision.

For every endpoint, DDS vendors try the rules of a grant, and the expressions of a rule, from first to last.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from comarmor.patterns import glob
from comarmor.patterns.glob import Glob
from comarmor.patterns.matching import matcher, matches
from comarmor.patterns.relations import all_disjoint
from comarmor.values import dataclass
from keymint_ros2_dds.compiling.gathering import GUARD
from keymint_ros2_dds.lowering.dds_topics import TopicAction
from keymint_ros2_dds.lowering.grant_rules import GrantRule, is_name


@dataclass(frozen=True, slots=True)
class EndpointCount:
    """How often the subject creates an endpoint, from ``--hints``."""

    action: str
    topic: str
    partition: str
    times: int


def prioritised(rules: Sequence[GrantRule[str]], counts: Sequence[EndpointCount]) -> tuple[GrantRule[str], ...]:
    """Return the rules with those that are requested more often earlier; decisions stay the same.

    The expressions of a rule may have any order. Two neighbouring rules are swapped only if they have the same effect
    and partitions, or share no topic; an allow rule stays first and last, as RTI Connext requires.

    Args:
        rules: rules of a grant.
        counts: the endpoints that the subject creates.
    """
    if not counts:
        return tuple(rules)
    counted = [_counted(rule, counts) for rule in rules]
    ordered = [rule for rule, _ in counted]
    weights = [weight for _, weight in counted]
    moved = True
    while moved:
        moved = False
        for n in range(1, len(ordered)):
            if weights[n] > weights[n - 1] and _may_swap(ordered, n):
                ordered[n - 1], ordered[n] = ordered[n], ordered[n - 1]
                weights[n - 1], weights[n] = weights[n], weights[n - 1]
                moved = True
    return tuple(ordered)


def _counted(rule: GrantRule[str], counts: Sequence[EndpointCount]) -> tuple[GrantRule[str], int]:
    """Return a rule with its expressions in order, and how often it is requested."""
    partitions = [glob.parse(text) for text in rule.partitions]
    total = 0
    topics: dict[TopicAction, tuple[str, ...]] = {}
    for action, texts in rule.topics.items():
        times: dict[str, int] = {}
        for count in counts:
            if count.action == action and any(matches(pattern, count.partition) for pattern in partitions):
                times[count.topic] = times.get(count.topic, 0) + count.times
        weight = {text: _weight(text, times) for text in texts}
        topics[action] = tuple(sorted(texts, key=lambda text: (-weight[text], text)))
        total += sum(weight.values())
    return GrantRule(rule.effect, rule.partitions, topics), total


def _weight(text: str, times: Mapping[str, int]) -> int:
    if is_name(text):
        return times.get(text, 0)
    matches_topic = matcher(glob.parse(text))
    return sum(count for topic, count in times.items() if matches_topic(topic))


def _may_swap(rules: Sequence[GrantRule[str]], n: int) -> bool:
    """Tell whether a rule may move before its predecessor."""
    before, rule = rules[n - 1], rules[n]
    if (TopicAction.RELAY in before.topics) is not (TopicAction.RELAY in rule.topics):
        return False  # relay rules, which some vendors ignore, stay at the end
    if before.effect is not rule.effect and (n == 1 or n == len(rules) - 1 or _is_guard(before)):
        return False
    if (before.effect, before.partitions) == (rule.effect, rule.partitions):
        return True
    return all_disjoint(_patterns(before), _patterns(rule))


def _patterns(rule: GrantRule[str]) -> list[Glob]:
    return [glob.parse(text) for texts in rule.topics.values() for text in texts]


def _is_guard(rule: GrantRule[str]) -> bool:
    """Tell whether a rule denies the names that the gathered topics after it match on Cyclone DDS only."""
    return any(GUARD in texts for texts in rule.topics.values())
