# SPDX-License-Identifier: Apache-2.0
"""Moves rules and expressions that are requested more often to the front, where that changes no decision.

For every endpoint, DDS vendors try the rules of a grant, and the expressions of a rule, from first to last.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

from comarmor.patterns import glob
from comarmor.patterns.glob import matcher, matches
from comarmor.patterns.relations import all_disjoint
from keymint_ros2_dds.compiling.gathering import GUARD
from keymint_ros2_dds.lowering.dds_topics import TopicAction
from keymint_ros2_dds.lowering.grant_rules import GrantRule, is_name

EndpointCounts = Mapping[tuple[str, str, str], int]
"""How often the subject creates endpoints, by action, topic and partition, from ``--hints``."""


def prioritised_rules(rules: Sequence[GrantRule[str]], counts: EndpointCounts) -> tuple[GrantRule[str], ...]:
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
    moved = True
    while moved:
        moved = False
        for n in range(1, len(counted)):
            (before, fewer), (rule, more) = counted[n - 1], counted[n]
            if more > fewer and _may_swap(before, rule, is_end=n in {1, len(rules) - 1}):
                counted[n - 1], counted[n] = counted[n], counted[n - 1]
                moved = True
    return tuple(rule for rule, _ in counted)


def _counted(rule: GrantRule[str], counts: EndpointCounts) -> tuple[GrantRule[str], int]:
    """Return a rule with its expressions in order, and how often it is requested."""
    partitions = [glob.parse(text) for text in rule.partitions]
    total = 0
    topics: dict[TopicAction, tuple[str, ...]] = {}
    for action, texts in rule.topics.items():
        times: Counter[str] = Counter()
        for (requested, topic, partition), number in counts.items():
            if requested == action and any(matches(pattern, partition) for pattern in partitions):
                times[topic] += number
        weight = {text: _weight(text, times) for text in texts}
        topics[action] = tuple(sorted(texts, key=lambda text: (-weight[text], text)))
        total += sum(weight.values())
    return GrantRule(rule.effect, rule.partitions, topics), total


def _weight(text: str, times: Counter[str]) -> int:
    if is_name(text):
        return times[text]
    matches_topic = matcher(glob.parse(text))
    return sum(count for topic, count in times.items() if matches_topic(topic))


def _may_swap(before: GrantRule[str], rule: GrantRule[str], *, is_end: bool) -> bool:
    """Tell whether a rule may move before its predecessor; at an end, one of them is the first or the last rule."""
    if (TopicAction.RELAY in before.topics) is not (TopicAction.RELAY in rule.topics):
        return False  # relay rules, which some vendors ignore, stay at the end
    if before.effect is not rule.effect and (is_end or GUARD in before.every_topic()):
        return False  # a guard denies what the gathered topics after it match on Cyclone DDS only
    if (before.effect, before.partitions) == (rule.effect, rule.partitions):
        return True
    return all_disjoint(*([glob.parse(text) for text in each.every_topic()] for each in (before, rule)))
