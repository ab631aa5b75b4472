# SPDX-License-Identifier: Apache-2.0
"""Orders the rules of a grant so that every DDS vendor decides in the same way.

First the patterns of each action are grouped so that groups share no name. A group has simple rules if its patterns
share a list of partitions, and a detailed decision list otherwise. Then the groups are ordered. The form, for a subject
that is allowed anything at all::

    allow  what no denial of the same direction overlaps
    deny   publish ...      allow  publish the rest
    deny   subscribe ...    allow  subscribe the rest
    (the same for relay)

Three vendor behaviours shape it:

* Cyclone DDS up to 0.10 lets the first rule that names a topic, in either direction, decide whether the topic may
  be created. A name that one direction denies and the other allows is therefore allowed before it is denied.
* RTI Connext lets the first rule of a domain decide about joining, earlier releases the last. So the rules begin and
  end with an allow rule; where none can be first, one without criteria is.
* Cyclone DDS ignores ``relay``, so its rules are separate, at the end.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence

from comarmor.patterns.glob import Glob, literal, sort_key
from comarmor.patterns.relations import TooComplexError, all_disjoint, disjoint, intersection, union_covers
from comarmor.rules import Effect
from comarmor.values import Data
from keymint.api import lazy
from keymint_ros2_dds.compiling.arrangement import Arrangement, arrange, early_rules
from keymint_ros2_dds.lowering.lowered_rules import DEFAULT, EVERY, GrantRule, Lowered, Partitions, with_leading_allow
from keymint_ros2_dds.lowering.name_mapping import TOPIC_ACTIONS, TopicAction
from keymint_ros2_dds.lowering.portable_expressions import Step, UnportableError

_uniform = lazy("keymint_ros2_dds.compiling.partitions:uniform")  # few policies have partitions
_decision_list = lazy("keymint_ros2_dds.compiling.partitions:decision_list")
_partitions_left = lazy("keymint_ros2_dds.compiling.partitions:partitions_left")


class RuleGroup(Data):
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


def rule_groups(
    action: TopicAction, allow: Collection[Step], deny: Collection[Step], *, reduced: bool = True
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
    in_order = (sorted(steps, key=lambda step: (sort_key(step[0]), step[1])) for steps in (allow, deny))
    for allowed, denied in _components(*in_order):
        try:
            shared = _uniform(allowed, denied)
        except ValueError:  # a name is denied in every partition; the detailed list says where
            shared = None
        if shared is None:
            rules = merged_rules(_rules(action, _decision_list(allowed, denied)), across_effects=True)
            end = next((index for index, rule in enumerate(rules) if rule.effect is Effect.DENY), len(rules))
            detailed.append(RuleGroup(tuple(rules[:end]), tuple(rules[end:]), EVERY, None))
        else:
            group = simple.setdefault(shared, ([], []))
            group[0].extend(allowed)
            group[1].extend(denied)
    return [*(_simple(action, *simple[shared], shared, reduced=reduced) for shared in sorted(simple)), *detailed]


def _simple(
    action: TopicAction, allow: Iterable[Step], deny: Iterable[Step], shared: Partitions, *, reduced: bool
) -> RuleGroup:
    denied = (pattern for pattern, partitions in deny if not (partitions and _partitions_left(shared, partitions)))
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
            near = [item[0], *(pattern for pattern in narrowed if not disjoint(item[0], pattern))]
            joined = [group for group in groups if any(not disjoint(each, p) for p, _ in group for each in near)]
            groups = [group for group in groups if group not in joined]
            groups.append([item, *(each for group in joined for each in group)])
    for group in (*separate.values(), *groups):
        yield group, [(d, partitions) for d, partitions in deny if any(not disjoint(d, p) for p, _ in group)]


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


_ORDER = "portability-order"
_Groups = Mapping[TopicAction, Sequence[RuleGroup]]
_Early = tuple[TopicAction, RuleGroup, Arrangement]


def portable_rules(lowered: Lowered, *, reduced: bool = True) -> tuple[GrantRule[Glob], ...]:
    """Return the rules of a grant; none if nothing is allowed.

    Args:
        lowered: the allowed and denied patterns.
        reduced: drop redundant patterns.

    Raises:
        UnportableError: Cyclone DDS and the standard would disagree on every order, or the partitions cannot be
            expressed portably across DDS vendors.
    """
    groups = {
        each: rule_groups(each, lowered.allow[each], lowered.deny[each], reduced=reduced) for each in TOPIC_ACTIONS
    }
    relay = groups.pop("relay")
    relay_rules = [*(rule for group in relay for rule in group.free), *(r for group in relay for r in group.ordered)]
    return with_leading_allow([*_both_directions(groups), *merged_rules(relay_rules)])


def _both_directions(groups: _Groups) -> list[GrantRule[Glob]]:
    """Return the rules for publish and subscribe in the shortest order that every vendor reads in the same way."""
    free = [rule for action in groups for group in groups[action] for rule in group.free]
    if not any(group.ordered for action in groups for group in groups[action]):
        return merged_rules(free)
    publish: TopicAction = "publish"
    subscribe: TopicAction = "subscribe"
    orders: list[tuple[tuple[TopicAction, ...], tuple[TopicAction, ...]]]
    orders = [((publish, subscribe), (subscribe,)), ((subscribe, publish), (publish,))]
    if all(group.arrangement for group in (*groups[publish], *groups[subscribe])):
        orders.insert(0, ((), (publish, subscribe)))
    candidates: list[list[GrantRule[Glob]]] = []
    refused: UnportableError | None = None
    known: dict[TopicAction, list[_Early]] = {}
    for action in (subscribe, publish):
        try:
            known[action] = _early(action, groups, free)
        except UnportableError as error:
            refused = error
    for order, early_actions in orders:
        if not known.keys() >= set(early_actions):
            continue
        early = [item for action in early_actions for item in known[action]]
        if order or not any(rules.rest for _, _, rules in early):
            turns: list[_Groups] = [{action: groups[action]} for action in order]
            turns = turns or [groups]
            rest = [rule for turn in turns for rule in merged_rules(_denials_first(turn))]
            candidates.append([*_first(free, early), *rest])
    if not candidates and refused:
        raise refused
    # By approximate size, where a rule counts as two patterns.
    return min(candidates, key=lambda rules: sum(2 + sum(map(len, rule.topics.values())) for rule in rules))


def _early(action: TopicAction, groups: _Groups, free: Iterable[GrantRule[Glob]]) -> list[_Early]:
    """Return the patterns that one direction must allow before the denials of the other direction.

    Args:
        action: what the direction is about.
        groups: the groups of both directions.
        free: the rules that no denial overlaps, which come first.

    Raises:
        UnportableError: there are no such rules.
    """
    other: TopicAction = "subscribe" if action == "publish" else "publish"
    denials = (rule for group in groups[other] for rule in group.ordered if rule.effect is Effect.DENY)
    denied = [pattern for rule in denials for pattern in rule.every_topic()]
    result: list[_Early] = []
    for group in groups[action]:
        try:
            if group.arrangement:
                result.append((action, group, early_rules(denied, group.arrangement)))
            elif clash := _clash(denied, action, group, free):
                reason = (
                    "it is denied in one direction, allowed in the other, and narrowed to several lists of partitions: "
                    "Cyclone DDS up to 0.10 lets the denial decide for both directions"
                )
                raise UnportableError(clash, reason, _ORDER)
        except TooComplexError:
            reason = "it overlaps what the other direction allows in too many ways"
            raise UnportableError(denied[0], reason, _ORDER) from None
    return result


def _clash(
    denied: Iterable[Glob], action: TopicAction, group: RuleGroup, earlier: Iterable[GrantRule[Glob]]
) -> Glob | None:
    """Return a denied pattern if a detailed list allows some of its names that no earlier rule names; else None."""
    named = [pattern for rule in earlier for pattern in rule.every_topic()]
    for rule in group.ordered:
        patterns = rule.topics[action]
        if rule.effect is Effect.DENY:
            named.extend(patterns)
            continue
        for deny in denied:
            pieces = (piece for allow in patterns for piece in intersection(deny, allow))
            if any(not union_covers(tuple(named), piece) for piece in pieces):
                return deny
    return None


def _first(free: Iterable[GrantRule[Glob]], early: Iterable[_Early]) -> list[GrantRule[Glob]]:
    """Return the rules that no denial overlaps, and those that must precede the denials of the other direction."""
    clean = (GrantRule(Effect.ALLOW, group.partitions, {action: e.free}) for action, group, e in early if e.free)
    result = merged_rules([*free, *clean])
    for action, group, each in early:
        if each.rest:
            result.append(GrantRule(Effect.DENY, denied_partitions(group.partitions), {action: each.deny}))
            result.append(GrantRule(Effect.ALLOW, group.partitions, {action: each.rest}))
    return result


def _denials_first(groups: _Groups) -> list[GrantRule[Glob]]:
    """Return the ordered rules of all groups: those of simple groups, denials first, then those of detailed groups."""
    every = [group for action in groups for group in groups[action]]
    simple = [rule for group in every if group.arrangement for rule in group.ordered]
    detailed = [rule for group in every if not group.arrangement for rule in group.ordered]
    return [*sorted(simple, key=lambda rule: rule.effect is Effect.ALLOW), *detailed]


def rule_per_policy_rule(rules: Iterable[GrantRule[Glob]], lowered: Lowered) -> tuple[GrantRule[Glob], ...]:
    """Split rules so that each has the patterns of one policy rule only.

    The parts of a rule have the same effect and partitions, so splitting changes no decision.
    """
    of_policy = reversed([*lowered.patterns()])  # the first rule that has a pattern counts
    owners = {(effect, action, pattern): policy_rule for effect, action, pattern, policy_rule in of_policy}
    result: list[GrantRule[Glob]] = []
    for rule in rules:
        parts: dict[int, dict[TopicAction, list[Glob]]] = {}
        for action, patterns in rule.topics.items():
            for pattern in patterns:
                owner = owners.get((rule.effect, action, pattern))
                parts.setdefault(id(owner), {}).setdefault(action, []).append(pattern)
        for part in parts.values() if parts else ({},):
            topics = {action: tuple(patterns) for action, patterns in part.items()}
            result.append(GrantRule(rule.effect, rule.partitions, topics))
    return tuple(result)


def standard_rules(lowered: Lowered) -> tuple[GrantRule[Glob], ...]:
    """Return rules that follow the standard, for policies that vendors read differently.

    All denials come first, then the allowed patterns, with a rule for each list of partitions.
    """
    result: list[GrantRule[Glob]] = []
    for effect, sides in ((Effect.DENY, lowered.deny), (Effect.ALLOW, lowered.allow)):
        rules = [
            GrantRule(effect, partitions or (EVERY if effect is Effect.DENY else DEFAULT), {action: (pattern,)})
            for action in TOPIC_ACTIONS
            for pattern, partitions in sides[action]
        ]
        result += merged_rules(sorted(rules, key=lambda rule: rule.partitions))
    return with_leading_allow(result) if any(lowered.allow.values()) else ()
