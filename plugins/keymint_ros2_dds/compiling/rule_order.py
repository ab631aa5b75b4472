# SPDX-License-Identifier: Apache-2.0
"""Orders the rules of a grant so that every DDS vendor decides in the same way.

The form, for a subject that is allowed anything at all::

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

from collections.abc import Iterable, Mapping, Sequence

from comarmor.patterns.glob import Glob
from comarmor.patterns.relations import TooComplexError, intersection, union_covers
from comarmor.rules import Effect
from keymint.ir import Rule
from keymint.keymake.order import EarlyRules, early_rules
from keymint_ros2_dds.compiling.partitions import UnportableError
from keymint_ros2_dds.compiling.rule_groups import RuleGroup, denied_partitions, merged_rules, rule_groups
from keymint_ros2_dds.lowering.dds_topics import TopicAction
from keymint_ros2_dds.lowering.grant_rules import DEFAULT, EVERY, GrantRule, with_leading_allow
from keymint_ros2_dds.lowering.lowered_rules import Lowered

_ORDER = "portability-order"
_Groups = Mapping[TopicAction, Sequence[RuleGroup]]
_Early = tuple[TopicAction, RuleGroup, EarlyRules]


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
        action: rule_groups(action, tuple(lowered.allow[action]), tuple(lowered.deny[action]), reduced=reduced)
        for action in TopicAction
    }
    relay = groups.pop(TopicAction.RELAY)
    relay_rules = [*(rule for group in relay for rule in group.free), *(r for group in relay for r in group.ordered)]
    return with_leading_allow([*_both_directions(groups), *merged_rules(relay_rules)])


def _both_directions(groups: _Groups) -> list[GrantRule[Glob]]:
    """Return the rules for publish and subscribe in the shortest order that every vendor reads in the same way."""
    free = [rule for action in groups for group in groups[action] for rule in group.free]
    if not any(group.ordered for action in groups for group in groups[action]):
        return merged_rules(free)
    publish, subscribe = TopicAction.PUBLISH, TopicAction.SUBSCRIBE
    orders: list[tuple[tuple[TopicAction, ...], tuple[TopicAction, ...]]]
    orders = [((publish, subscribe), (subscribe,)), ((subscribe, publish), (publish,))]
    if all(group.arrangement for group in (*groups[publish], *groups[subscribe])):
        orders.insert(0, ((), (publish, subscribe)))
    candidates: list[list[GrantRule[Glob]]] = []
    refused: UnportableError | None = None
    known: dict[TopicAction, list[_Early]] = {}
    for action in (subscribe, publish):
        try:
            known[action] = _early(action, groups)
        except UnportableError as error:
            refused = error
    for order, early_actions in orders:
        if not known.keys() >= set(early_actions):
            continue
        early = [item for action in early_actions for item in known[action]]
        if order or not any(rules.dirty for _, _, rules in early):
            turns: list[_Groups] = [{action: groups[action]} for action in order]
            turns = turns or [groups]
            rest = [rule for turn in turns for rule in merged_rules(_denials_first(turn))]
            candidates.append([*_first(free, early), *rest])
    if not candidates and refused:
        raise refused
    return min(candidates, key=_cost)


def _cost(rules: Iterable[GrantRule[Glob]]) -> int:
    """Return the approximate size of rules: a rule counts as two patterns."""
    return sum(2 + sum(map(len, rule.topics.values())) for rule in rules)


def _early(action: TopicAction, groups: _Groups) -> list[_Early]:
    """Return the patterns that one direction must allow before the denials of the other direction.

    Raises:
        UnportableError: there are no such rules.
    """
    other = TopicAction.SUBSCRIBE if action is TopicAction.PUBLISH else TopicAction.PUBLISH
    denied = [pattern for group in groups[other] for pattern in group.denied]
    result: list[_Early] = []
    for group in groups[action]:
        try:
            if group.arrangement:
                result.append((action, group, early_rules(denied, group.arrangement)))
            elif clash := _clash(denied, action, group, _free_patterns(groups)):
                reason = (
                    "it is denied in one direction, allowed in the other, and narrowed to several lists of partitions: "
                    "Cyclone DDS up to 0.10 lets the denial decide for both directions"
                )
                raise UnportableError(clash, reason, _ORDER)
        except TooComplexError:
            reason = "it overlaps what the other direction allows in too many ways"
            raise UnportableError(denied[0], reason, _ORDER) from None
    return result


def _free_patterns(groups: _Groups) -> list[Glob]:
    rules = (rule for action in groups for group in groups[action] for rule in group.free)
    return [pattern for rule in rules for pattern in rule.every_topic()]


def _clash(denied: Iterable[Glob], action: TopicAction, group: RuleGroup, earlier: Iterable[Glob]) -> Glob | None:
    """Return a denied pattern if a detailed list allows some of its names that no earlier rule names; else None."""
    named = list(earlier)
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
    clean = (GrantRule(Effect.ALLOW, group.partitions, {action: e.clean}) for action, group, e in early if e.clean)
    result = merged_rules([*free, *clean])
    for action, group, each in early:
        if each.dirty:
            result.append(GrantRule(Effect.DENY, denied_partitions(group.partitions), {action: each.deny}))
            result.append(GrantRule(Effect.ALLOW, group.partitions, {action: each.dirty}))
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
    owners: dict[tuple[Effect, TopicAction, Glob], Rule] = {}
    for effect, action, pattern, policy_rule in lowered.patterns():
        owners.setdefault((effect, action, pattern), policy_rule)
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
            for action in TopicAction
            for pattern, partitions in sides[action]
        ]
        result += merged_rules(sorted(rules, key=lambda rule: rule.partitions))
    return with_leading_allow(result) if any(lowered.allow.values()) else ()
