# SPDX-License-Identifier: Apache-2.0
"""Rewrites the rules of a grant to equivalent ones: fewer expressions, and what is requested more often first.

Gathering topics into bracket expressions makes some documents much smaller. Cyclone DDS lets every bracket expression
match ``]`` as well, see :mod:`keymint_ros2_dds.lowering.portable_expressions`. So rules with gathered topics come last,
after a denial of every name with a ``]``; the names that they permit have none.

For every endpoint, DDS vendors try the rules of a grant, and the expressions of a rule, from first to last. So those
that are requested more often move to the front, where that changes no decision.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import product

from comarmor.patterns import glob
from comarmor.patterns.glob import matcher, matches
from comarmor.patterns.relations import all_disjoint
from comarmor.rules import Effect
from keymint.api import lazy
from keymint_ros2_dds.lowering.lowered_rules import DEFAULT, EVERY, GrantRule, Partitions, is_name, with_leading_allow
from keymint_ros2_dds.lowering.name_mapping import TopicAction

# Few documents are large enough.
_gather = lazy("keymint_ros2_dds.compiling.gathering:gather")
_similar = lazy("keymint_ros2_dds.compiling.gathering:similar")
GUARD = "*]*"
"""The names that match on Cyclone DDS and not by the standard."""
MIN_SAVED = 1_024
"""Bytes that gathering must save, since OpenDDS and RTI Connext may not know bracket expressions."""
MIN_SAVED_PART = 10
"""The part of the document, here a tenth, that gathering must save as well."""

_RULE, _CRITERIA, _TOPIC = 130, 90, 28
"""Approximate bytes of a rule, of its criteria for an action, and of an expression, without the texts in them."""
_ACTIONS: tuple[TopicAction, ...] = ("publish", "subscribe")
_Gathered = dict[Partitions, dict[TopicAction, tuple[str, ...]]]
"""Gathered topics by partitions and action."""


def gathered_rules(rules: Sequence[GrantRule[str]], *, min_saved: int | None = None) -> tuple[GrantRule[str], ...]:
    """Return rules that permit the same with fewer expressions; the unchanged rules if that saves little.

    Args:
        rules: rules of a grant.
        min_saved: bytes that must be saved; by default :data:`MIN_SAVED` and a part of :data:`MIN_SAVED_PART`.
    """
    most = _most_saved(rules)
    if min_saved is None and most < MIN_SAVED:
        return tuple(rules)
    size = _size(rules)
    if min_saved is None:
        min_saved = max(MIN_SAVED, size // MIN_SAVED_PART)
    if most < min_saved or _most_shared(rules) < min_saved:
        return tuple(rules)
    relay = next((n for n, rule in enumerate(rules) if rule.topics.keys() == {"relay"}), len(rules))
    endpoints, relays = rules[:relay], rules[relay:]
    movable = _named_once(endpoints)
    remaining: list[GrantRule[str]] = []
    gathered_topics: _Gathered = {}
    for rule in endpoints:
        topics = dict(rule.topics)
        for action in _ACTIONS if rule.effect is Effect.ALLOW else ():
            names = [text for text in topics.get(action, ()) if text in movable]
            sets = [pattern for pattern in _gather(names) if any(len(members) > 1 for members in pattern)]
            if sets:
                members = {"".join(letters) for pattern in sets for letters in product(*pattern)}
                topics[action] = tuple(text for text in topics[action] if text not in members)
                texts = gathered_topics.setdefault(rule.partitions, {})
                written = ("".join(each if len(each) == 1 else f"[{each}]" for each in pattern) for pattern in sets)
                texts[action] = (*texts.get(action, ()), *written)
        kept = {action: texts for action, texts in topics.items() if texts}
        if kept or not rule.topics:
            remaining.append(GrantRule(rule.effect, rule.partitions, kept))
    result = (*_joined(remaining, gathered_topics), *relays)
    return result if gathered_topics and size - _size(result) >= min_saved else tuple(rules)


def _joined(remaining: Sequence[GrantRule[str]], topics: _Gathered) -> tuple[GrantRule[str], ...]:
    """Return the remaining rules, then the guard and the gathered topics; an allow rule comes first."""
    denied = DEFAULT if set(topics) == {DEFAULT} else EVERY
    guarded = {action: (GUARD,) for action in _ACTIONS if any(action in each for each in topics.values())}
    guard = GrantRule(Effect.DENY, denied, guarded)
    last = [
        GrantRule(Effect.ALLOW, partitions, {action: tuple(sorted(texts)) for action, texts in by_action.items()})
        for partitions, by_action in sorted(topics.items())
    ]
    return with_leading_allow([*remaining, guard, *last])


def _named_once(rules: Sequence[GrantRule[str]]) -> frozenset[str]:
    """Return the topic names that only one rule matches and the guard does not: they may move to any place."""
    owner: dict[str, int] = {}
    several: set[str] = set()
    wild: dict[int, list[Callable[[str], bool]]] = {}
    for number, rule in enumerate(rules):
        for text in rule.every_topic():
            if not is_name(text):
                wild.setdefault(number, []).append(matcher(glob.parse(text)))
            elif owner.setdefault(text, number) != number:
                several.add(text)
    return frozenset(
        text
        for text, number in owner.items()
        if text not in several
        and "]" not in text
        and not any(matches(text) for other, matchers in wild.items() if other != number for matches in matchers)
    )


def _most_saved(rules: Iterable[GrantRule[str]]) -> int:
    """Return an upper bound of the bytes that gathering saves; quick to compute for the many short documents.

    Names of different lengths share no expression.
    """
    names = kept = emptied = 0
    for rule in (rule for rule in rules if rule.effect is Effect.ALLOW):
        emptied += _RULE
        for texts in rule.topics.values():
            emptied += _CRITERIA
            lengths = tuple(map(len, texts))
            others = {*lengths}
            names += sum(lengths) + _TOPIC * len(lengths)
            kept += sum(others) + _TOPIC * len(others)
    return min(names, names - kept + emptied) - 2 * (_RULE + _CRITERIA)


def _most_shared(rules: Iterable[GrantRule[str]]) -> int:
    """Return a closer bound, without the names that are similar to no other one."""
    most = 0
    for rule in rules:
        for action in _ACTIONS if rule.effect is Effect.ALLOW else ():
            texts = rule.topics.get(action, ())
            close = _similar(texts)
            most += sum(_TOPIC + len(text) for text in close)
            most += _RULE + _CRITERIA if len(close) == len(texts) else 0
    return most


def _size(rules: Iterable[GrantRule[str]]) -> int:
    return sum(
        _RULE + sum(_CRITERIA + sum(_TOPIC + len(text) for text in texts) for texts in rule.topics.values())
        for rule in rules
    )


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
    if ("relay" in before.topics) is not ("relay" in rule.topics):
        return False  # relay rules, which some vendors ignore, stay at the end
    if before.effect is not rule.effect and (is_end or GUARD in before.every_topic()):
        return False  # a guard denies what the gathered topics after it match on Cyclone DDS only
    if (before.effect, before.partitions) == (rule.effect, rule.partitions):
        return True
    return all_disjoint(*([glob.parse(text) for text in each.every_topic()] for each in (before, rule)))
