"""Priority: what is asked for more often stands earlier, where the meaning allows it.

Implementations go through the rules of a grant, and through the expressions of a rule, from the first to the last for
every endpoint.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from comarmor.patterns import glob
from comarmor.patterns.matching import matcher, matches
from comarmor.patterns.relations import all_disjoint
from keymint_ros2_dds.compiling.criteria import Criteria, is_name
from keymint_ros2_dds.compiling.gathering import GUARD
from keymint_ros2_dds.lowering.mapping import Action


@dataclass(frozen=True, slots=True)
class Asked:
    """An endpoint that is asked for: action, name of the topic, its partition, and how often."""

    action: str
    topic: str
    partition: str
    times: int


def prioritised(rules: Sequence[Criteria], demand: Sequence[Asked]) -> tuple[Criteria, ...]:
    """Return the rules with those that are asked for more often earlier; they decide alike.

    The expressions of a rule may stand in any order. Two neighbours change places only when they have the effect and
    the partitions in common, or no topic; and an allow rule stays first and last, as RTI Connext wants it.

    Args:
        rules: rules of a grant.
        demand: what the subject asks for.
    """
    if not demand:
        return tuple(rules)
    counted = [_counted(rule, demand) for rule in rules]
    ordered = [rule for rule, _ in counted]
    weights = [weight for _, weight in counted]
    moved = True
    while moved:
        moved = False
        for at in range(1, len(ordered)):
            if weights[at] > weights[at - 1] and _may_swap(ordered, at):
                ordered[at - 1], ordered[at] = ordered[at], ordered[at - 1]
                weights[at - 1], weights[at] = weights[at], weights[at - 1]
                moved = True
    return tuple(ordered)


def _counted(rule: Criteria, demand: Sequence[Asked]) -> tuple[Criteria, int]:
    """Return a rule with its expressions in order, and how often it is asked for."""
    listed = [glob.parse(text) for text in rule.partitions]
    total = 0
    topics: dict[Action, tuple[str, ...]] = {}
    for action, texts in rule.topics.items():
        times: dict[str, int] = {}
        for asked in demand:
            if asked.action == action and any(matches(pattern, asked.partition) for pattern in listed):
                times[asked.topic] = times.get(asked.topic, 0) + asked.times
        weight = {text: _weight(text, times) for text in texts}
        topics[action] = tuple(sorted(texts, key=lambda text: (-weight[text], text)))
        total += sum(weight.values())
    return Criteria(rule.effect, rule.partitions, topics), total


def _weight(text: str, times: Mapping[str, int]) -> int:
    if is_name(text):
        return times.get(text, 0)
    test = matcher(glob.parse(text))
    return sum(count for topic, count in times.items() if test(topic))


def _may_swap(rules: Sequence[Criteria], at: int) -> bool:
    """Tell whether a rule may stand before the one that is before it."""
    before, rule = rules[at - 1], rules[at]
    if (Action.RELAY in before.topics) is not (Action.RELAY in rule.topics):
        return False  # what one vendor ignores stays by itself at the end
    if before.effect is not rule.effect and (at == 1 or at == len(rules) - 1 or _guards(before)):
        return False
    if (before.effect, before.partitions) == (rule.effect, rule.partitions):
        return True
    texts, texts2 = ([glob.parse(text) for texts in each.topics.values() for text in texts] for each in (before, rule))
    return all_disjoint(texts, texts2)


def _guards(rule: Criteria) -> bool:
    """Tell whether a rule denies what Cyclone DDS would take the gathered topics behind it to match as well."""
    return any(GUARD in texts for texts in rule.topics.values())
