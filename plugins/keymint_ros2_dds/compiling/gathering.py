"""Gathering topics under bracket expressions, where that makes a document much smaller.

Cyclone DDS lets every bracket expression match ``]`` as well (see :mod:`keymint_ros2_dds.lowering.portable`). So rules
with gathered topics come last, after a denial of every name with a ``]``; the names that they permit have none.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import product

from comarmor.patterns import glob
from comarmor.patterns.matching import matcher
from comarmor.rules import Effect
from keymint.keymake.gather import Pattern, gather
from keymint_ros2_dds.compiling.criteria import Criteria, is_name
from keymint_ros2_dds.compiling.partitions import DEFAULT, EVERY
from keymint_ros2_dds.lowering.lower import Partitions
from keymint_ros2_dds.lowering.mapping import Action

GUARD = "*]*"
"""The names that Cyclone DDS takes to match where the standard does not."""
WORTH = 1_024
"""Bytes that gathering must save: OpenDDS and RTI Connext may not know bracket expressions, so less is not worth it."""
PART = 10
"""What it must save as well: one part in so many."""

_RULE, _CRITERIA, _TOPIC = 130, 90, 28
"""About how many bytes a rule, its criteria for an action, and an expression take, beside the texts in them."""
_ACTIONS = (Action.PUBLISH, Action.SUBSCRIBE)


def gathered(rules: Sequence[Criteria], *, least: int | None = None) -> tuple[Criteria, ...]:
    """Return rules that permit the same with fewer expressions; the rules as they are where that saves little.

    Args:
        rules: rules of a grant.
        least: bytes that are to be saved; by default :data:`WORTH`, and one part in :data:`PART`.
    """
    size = _size(rules)
    if least is None:
        least = max(WORTH, size // PART)
    if _at_most(rules) < least:
        return tuple(rules)
    relay = next((at for at, rule in enumerate(rules) if rule.topics and not _speaks(rule)), len(rules))
    own, relays = rules[:relay], rules[relay:]
    free = _said_once(own)
    left: list[Criteria] = []
    found: dict[Partitions, dict[Action, tuple[str, ...]]] = {}
    for rule in own:
        topics = dict(rule.topics)
        for action in _ACTIONS if rule.effect is Effect.ALLOW else ():
            names = [text for text in topics.get(action, ()) if text in free]
            sets = [pattern for pattern in gather(names) if any(len(members) > 1 for members in pattern)]
            if sets:
                taken = _expanded(sets)
                topics[action] = tuple(text for text in topics[action] if text not in taken)
                texts = found.setdefault(rule.partitions, {})
                texts[action] = (*texts.get(action, ()), *map(_written, sets))
        kept = {action: texts for action, texts in topics.items() if texts}
        if kept or not rule.topics:
            left.append(Criteria(rule.effect, rule.partitions, kept))
    result = (*_begun(left, found), *relays)
    return result if found and size - _size(result) >= least else tuple(rules)


def _begun(left: Sequence[Criteria], found: Mapping[Partitions, Mapping[Action, tuple[str, ...]]]) -> list[Criteria]:
    """Return the rules that are left, then the guard and what was gathered; an allow rule comes first."""
    denied = DEFAULT if set(found) == {DEFAULT} else EVERY
    actions = {action for topics in found.values() for action in topics}
    guard = Criteria(Effect.DENY, denied, {action: (GUARD,) for action in _ACTIONS if action in actions})
    last = [
        Criteria(Effect.ALLOW, listed, {action: tuple(sorted(texts)) for action, texts in topics.items()})
        for listed, topics in sorted(found.items())
    ]
    first = [] if left and left[0].effect is Effect.ALLOW else [Criteria(Effect.ALLOW, DEFAULT, {})]
    return [*first, *left, guard, *last]


def _speaks(rule: Criteria) -> bool:
    return any(action in rule.topics for action in _ACTIONS)


def _said_once(rules: Sequence[Criteria]) -> frozenset[str]:
    """Return the names of topics that one rule alone says anything of, and not the guard: they may stand anywhere."""
    owner: dict[str, int] = {}
    several: set[str] = set()
    wild: dict[int, list[Callable[[str], bool]]] = {}
    for at, rule in enumerate(rules):
        for text in (text for texts in rule.topics.values() for text in texts):
            if not is_name(text):
                wild.setdefault(at, []).append(matcher(glob.parse(text)))
            elif owner.setdefault(text, at) != at:
                several.add(text)
    return frozenset(
        text
        for text, at in owner.items()
        if text not in several
        and "]" not in text
        and not any(matches(text) for other, tests in wild.items() if other != at for matches in tests)
    )


def _expanded(patterns: Iterable[Pattern]) -> frozenset[str]:
    return frozenset("".join(letters) for pattern in patterns for letters in product(*pattern))


def _written(pattern: Pattern) -> str:
    return "".join(members if len(members) == 1 else f"[{members}]" for members in pattern)


def _at_most(rules: Iterable[Criteria]) -> int:
    """Return how many bytes can be saved, if every name goes: cheap to find out for the many rules that are short."""
    allowing = (texts for rule in rules if rule.effect is Effect.ALLOW for texts in rule.topics.values())
    names = sum(_TOPIC + len(text) for texts in allowing for text in texts)
    return names - 2 * (_RULE + _CRITERIA)


def _size(rules: Iterable[Criteria]) -> int:
    return sum(
        _RULE + sum(_CRITERIA + sum(_TOPIC + len(text) for text in texts) for texts in rule.topics.values())
        for rule in rules
    )
