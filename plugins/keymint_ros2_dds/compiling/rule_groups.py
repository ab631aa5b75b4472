# SPDX-License-Identifier: Apache-2.0
"""Groups the patterns of an action so that groups share no name.

A group has simple rules if its patterns share a list of partitions, and a detailed decision list otherwise.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from comarmor.patterns.glob import Glob, literal
from comarmor.patterns.relations import all_disjoint, disjoint, sort_key
from comarmor.rules import Effect
from comarmor.values import dataclass
from keymint.keymake.order import Arrangement, arrange
from keymint_ros2_dds.compiling.partitions import Step, decision_list, touches, uniform
from keymint_ros2_dds.lowering.dds_topics import TopicAction
from keymint_ros2_dds.lowering.grant_rules import DEFAULT, EVERY, GrantRule, Partitions


@dataclass(frozen=True, slots=True)
class RuleGroup:
    """Rules for patterns of one action that match no name of another group of that action.

    Attributes:
        free: rules that no denial overlaps; they may precede all other rules.
        ordered: the rules from the first denial on.
        partitions: the list that all allowed patterns share.
        arrangement: the patterns of a simple list of rules; None for a detailed list.
    """

    free: tuple[GrantRule[Glob], ...]
    ordered: tuple[GrantRule[Glob], ...]
    partitions: Partitions
    arrangement: Arrangement | None

    @property
    def denied(self) -> tuple[Glob, ...]:
        """The patterns that are denied."""
        denials = (rule for rule in self.ordered if rule.effect is Effect.DENY)
        return tuple(pattern for rule in denials for pattern in rule.every_topic())


def rule_groups(
    action: TopicAction, allow: Sequence[Step], deny: Sequence[Step], *, reduced: bool = True
) -> list[RuleGroup]:
    """Return the rules of an action in groups that share no name.

    Args:
        action: the action.
        allow: allowed patterns with their partitions.
        deny: denied patterns with their partitions.
        reduced: drop redundant patterns of simple lists.

    Raises:
        UnportableError: the partitions cannot be expressed portably across DDS vendors.
    """
    if not any(partitions for _, partitions in (*allow, *deny)):
        return [_simple(action, allow, deny, DEFAULT, reduced=reduced)]
    detailed: list[RuleGroup] = []
    simple: dict[Partitions, tuple[list[Step], list[Step]]] = {}
    for allowed, denied in _components(sorted(allow, key=_sort_key), sorted(deny, key=_sort_key)):
        try:
            shared = uniform(allowed, denied)
        except ValueError:  # a name is denied in every partition; the detailed list says where
            shared = None
        if shared is None:
            rules = merged_rules(_rules(action, decision_list(allowed, denied)), across_effects=True)
            end = next((index for index, rule in enumerate(rules) if rule.effect is Effect.DENY), len(rules))
            detailed.append(RuleGroup(tuple(rules[:end]), tuple(rules[end:]), EVERY, None))
        else:
            group = simple.setdefault(shared, ([], []))
            group[0].extend(allowed)
            group[1].extend(denied)
    return [*(_simple(action, *simple[shared], shared, reduced=reduced) for shared in sorted(simple)), *detailed]


def _sort_key(step: Step) -> tuple[str, Partitions]:
    return sort_key(step[0]), step[1]


def _simple(
    action: TopicAction, allow: Iterable[Step], deny: Iterable[Step], shared: Partitions, *, reduced: bool
) -> RuleGroup:
    denied = (pattern for pattern, partitions in deny if touches(shared, partitions))
    order = arrange((pattern for pattern, _ in allow), dict.fromkeys(denied), reduced=reduced)
    free = (GrantRule(Effect.ALLOW, shared, {action: order.free}),) if order.free else ()
    ordered: tuple[GrantRule[Glob], ...] = ()
    if order.rest:
        ordered = (
            GrantRule(Effect.DENY, denied_partitions(shared), {action: order.deny}),
            GrantRule(Effect.ALLOW, shared, {action: order.rest}),
        )
    return RuleGroup(free, ordered, shared, order)


def denied_partitions(shared: Partitions) -> Partitions:
    """Return the partitions of a deny rule; Cyclone DDS applies one without any to the default partition only."""
    return DEFAULT if shared == DEFAULT else EVERY


def _components(allow: Sequence[Step], deny: Sequence[Step]) -> Iterator[tuple[list[Step], list[Step]]]:
    """Yield allowed patterns in groups that share no name, each with the denials that overlap it.

    A denial in some partitions only joins the patterns that it overlaps: its effect may differ for each list.
    """
    groups: list[list[Step]] = []
    narrowed = [pattern for pattern, partitions in deny if partitions]
    literals = {pattern for pattern, _ in (*allow, *deny) if literal(pattern) is not None}
    separate: dict[Glob, list[Step]] = {}
    wild = [p for p in (*(p for p, _ in allow), *narrowed) if p not in literals]
    for item in allow:
        if item[0] in literals and all(disjoint(item[0], other) for other in wild):
            separate.setdefault(item[0], []).append(item)
        else:
            joined = [group for group in groups if any(_joined(item[0], other, narrowed) for other, _ in group)]
            groups = [group for group in groups if group not in joined]
            groups.append([item, *(each for group in joined for each in group)])
    for group in (*separate.values(), *groups):
        yield group, [(d, partitions) for d, partitions in deny if any(not disjoint(d, p) for p, _ in group)]


def _joined(left: Glob, right: Glob, narrowed: Iterable[Glob]) -> bool:
    return not disjoint(left, right) or any(not disjoint(left, d) and not disjoint(right, d) for d in narrowed)


def _rules(action: TopicAction, steps: Iterable[Step]) -> Iterator[GrantRule[Glob]]:
    for pattern, partitions in steps:
        yield GrantRule(Effect.ALLOW if partitions else Effect.DENY, partitions or EVERY, {action: (pattern,)})


def merged_rules(rules: Iterable[GrantRule[Glob]], *, across_effects: bool = False) -> list[GrantRule[Glob]]:
    """Return rules with each one merged into the last one of the same effect and partitions that it may join.

    Args:
        rules: rules in their order.
        across_effects: a rule may overtake rules of the other effect too, if they share no name with it.
    """
    result: list[GrantRule[Glob]] = []
    for rule in rules:
        index = _joinable(result, rule, across_effects=across_effects)
        if index is None:
            result.append(rule)
        else:
            topics = dict(result[index].topics)
            for action, patterns in rule.topics.items():
                topics[action] = (*topics.get(action, ()), *patterns)
            result[index] = GrantRule(rule.effect, rule.partitions, topics)
    return result


def _joinable(rules: Sequence[GrantRule[Glob]], rule: GrantRule[Glob], *, across_effects: bool) -> int | None:
    """Return the index of the rule that another one can join without overtaking a rule that shares a name with it."""
    for index in range(len(rules) - 1, -1, -1):
        other = rules[index]
        if (other.effect, other.partitions) == (rule.effect, rule.partitions):
            return index
        if other.effect is not rule.effect and not across_effects:
            return None
        if not all(all_disjoint(other.topics.get(action, ()), patterns) for action, patterns in rule.topics.items()):
            return None
    return None
