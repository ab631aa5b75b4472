"""From what is allowed and denied to the rules of a grant, in an order that every vendor reads the same.

The form, for a subject that is allowed anything at all::

    allow  what no denial of the same direction touches
    deny   publish ...      allow  publish the rest
    deny   subscribe ...    allow  subscribe the rest
    (the same for relay)

Three habits of vendors shape it:

* Cyclone DDS up to 0.10 lets the first rule that names a topic, in either direction, decide whether the topic may
  be created. A name that one direction denies and the other allows is therefore allowed before it is denied.
* RTI Connext lets the first rule of a domain decide about joining, earlier releases the last. So the rules begin and
  end with an allow rule; where none can stand first, one without criteria does.
* ``relay`` is ignored by Cyclone DDS, so its rules stand by themselves at the end.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from keymint.ir import Effect
from keymint.keymake.algebra import TooComplexError, disjoint, intersection, union_covers
from keymint.keymake.glob import Glob
from keymint.keymake.order import Order, Rescue, arrange, mentioned_first
from keymint_ros2_dds import partitions as lists
from keymint_ros2_dds.lower import Lowered, Partitions
from keymint_ros2_dds.mapping import Action
from keymint_ros2_dds.partitions import DEFAULT, Entry


@dataclass(frozen=True, slots=True)
class Block:
    """A rule of a grant: an effect, the partitions of all its criteria, and patterns of topics by action."""

    effect: Effect
    partitions: Partitions
    topics: Mapping[Action, tuple[Glob, ...]]


class OrderError(Exception):
    """No order of rules is read alike by all vendors; carries a pattern and the reason in one line."""

    def __init__(self, pattern: Glob, reason: str) -> None:
        self.pattern = pattern
        self.reason = reason
        super().__init__(reason)


@dataclass(slots=True)
class _Plan:
    """A decision list for one action: a simple one, or one with several lists of partitions."""

    order: Order | None
    partitions: Partitions = DEFAULT
    entries: tuple[Entry, ...] = field(default=())

    @property
    def front(self) -> list[Entry]:
        if self.order:
            free = self.order.free
            return [Entry(Effect.ALLOW, free, self.partitions)] if free else []
        end = next((i for i, entry in enumerate(self.entries) if entry.effect is Effect.DENY), len(self.entries))
        return list(self.entries[:end])

    @property
    def back(self) -> list[Entry]:
        if self.order:
            if not self.order.rest:
                return []
            every = DEFAULT if self.partitions == DEFAULT else lists.EVERY
            return [
                Entry(Effect.DENY, self.order.deny, every),
                Entry(Effect.ALLOW, self.order.rest, self.partitions),
            ]
        return list(self.entries[len(self.front) :])


def blocks(lowered: Lowered) -> tuple[Block, ...]:
    """Return the rules of a grant; none when nothing is allowed.

    Raises:
        OrderError: Cyclone DDS and the standard would read every order differently.
        PartitionError: partitions cannot be said alike for all vendors.
    """
    publish, subscribe, relay = (_plan(tuple(lowered.allow[action]), tuple(lowered.deny[action])) for action in Action)
    found = [*_both(publish, subscribe), *_merged((), _tagged(relay, Action.RELAY))]
    if found and found[0].effect is Effect.DENY:
        found.insert(0, Block(Effect.ALLOW, DEFAULT, {}))
    return tuple(found)


def _plan(allow: tuple[tuple[Glob, Partitions], ...], deny: tuple[tuple[Glob, Partitions], ...]) -> _Plan:
    try:
        shared = lists.uniform(allow, deny)
    except ValueError:
        shared = None
    if shared is None:
        return _Plan(None, entries=lists.decision_list(allow, deny))
    denied = [pattern for pattern, listed in deny if lists.touches(shared, listed)]
    return _Plan(arrange([pattern for pattern, _ in allow], denied), shared)


_Tagged = tuple[Action, Entry]


def _tagged(plan: _Plan, action: Action) -> list[_Tagged]:
    return [(action, entry) for entry in (*plan.front, *plan.back)]


def _both(publish: _Plan, subscribe: _Plan) -> list[Block]:
    """Return the rules for both directions, in the shortest of the orders in which every vendor reads them alike."""
    sides = {Action.PUBLISH: publish, Action.SUBSCRIBE: subscribe}
    front = [(action, entry) for action, plan in sides.items() for entry in plan.front]
    if not publish.back and not subscribe.back:
        return _merged((), front)
    if publish.order and subscribe.order:
        return _rescued(sides, publish.order, subscribe.order)
    for first, second in ((Action.PUBLISH, Action.SUBSCRIBE), (Action.SUBSCRIBE, Action.PUBLISH)):
        clash = _clash(sides[first], sides[second])
        if clash is None:
            back = [(action, entry) for action in (first, second) for entry in sides[action].back]
            return [*_merged((), front), *_merged((), back)]
    raise OrderError(
        clash or (),
        "it is denied in one direction, allowed in the other, and narrowed to partitions: Cyclone DDS up to 0.10 lets "
        "the denial decide for both directions",
    )


def _clash(first: _Plan, second: _Plan) -> Glob | None:
    """Return a pattern that the first list denies before the second one allows it, or None."""
    said: list[Glob] = [glob for entry in (*first.front, *second.front) for glob in entry.globs]
    for entry in first.back:
        if entry.effect is Effect.ALLOW:
            said.extend(entry.globs)
            continue
        known = list(said)
        for other in second.back:
            if other.effect is Effect.ALLOW:
                for deny in entry.globs:
                    for allow in other.globs:
                        try:
                            pieces = intersection(deny, allow)
                        except TooComplexError:
                            return deny
                        if any(not union_covers(tuple(known), piece) for piece in pieces):
                            return deny
            else:
                known.extend(other.globs)
    return None


def _rescued(sides: Mapping[Action, _Plan], publish: Order, subscribe: Order) -> list[Block]:
    try:
        for_subscribe = mentioned_first(publish.deny, subscribe)
        for_publish = mentioned_first(subscribe.deny, publish)
    except TooComplexError:
        pattern = (publish.deny or subscribe.deny)[0]
        raise OrderError(pattern, "it overlaps what the other direction allows in too many ways") from None
    pub, sub = Action.PUBLISH, Action.SUBSCRIBE
    candidates = [_ordered(sides, (pub, sub), {sub: for_subscribe}), _ordered(sides, (sub, pub), {pub: for_publish})]
    if not for_subscribe.dirty and not for_publish.dirty:
        candidates.insert(0, _together(sides, {sub: for_subscribe, pub: for_publish}))
    return min(candidates, key=_cost)


def _cost(found: Iterable[Block]) -> int:
    """Return about how large rules are: a rule weighs as much as two patterns."""
    return sum(2 + sum(map(len, block.topics.values())) for block in found)


def _front(sides: Mapping[Action, _Plan], rescues: Mapping[Action, Rescue]) -> list[Block]:
    front = [(action, entry) for action, plan in sides.items() for entry in plan.front]
    front += [
        (action, Entry(Effect.ALLOW, rescue.clean, sides[action].partitions))
        for action, rescue in rescues.items()
        if rescue.clean
    ]
    found = _merged((), front)
    for action, rescue in rescues.items():
        if rescue.dirty:
            deny = DEFAULT if sides[action].partitions == DEFAULT else lists.EVERY
            found.append(Block(Effect.DENY, deny, {action: rescue.deny}))
            found.append(Block(Effect.ALLOW, sides[action].partitions, {action: rescue.dirty}))
    return found


def _ordered(
    sides: Mapping[Action, _Plan], order: tuple[Action, Action], rescues: Mapping[Action, Rescue]
) -> list[Block]:
    """Return the rules of one direction, then those of the other."""
    back = [
        Block(entry.effect, entry.partitions, {action: entry.globs}) for action in order for entry in sides[action].back
    ]
    return [*_front(sides, rescues), *back]


def _together(sides: Mapping[Action, _Plan], rescues: Mapping[Action, Rescue]) -> list[Block]:
    """Return rules that deny, and then allow, in both directions at once."""
    back = [(action, entry) for action, plan in sides.items() for entry in plan.back]
    back.sort(key=lambda pair: pair[1].effect is Effect.ALLOW)
    return [*_front(sides, rescues), *_merged((), back)]


def _merged(before: Iterable[Block], entries: Iterable[_Tagged]) -> list[Block]:
    """Turn entries into rules; neighbours with the same effect and partitions share one."""
    found = list(before)
    for action, entry in entries:
        at = _joinable(found, action, entry)
        if at is None:
            found.append(Block(entry.effect, entry.partitions, {action: entry.globs}))
        else:
            topics = dict(found[at].topics)
            topics[action] = (*topics.get(action, ()), *entry.globs)
            found[at] = Block(entry.effect, entry.partitions, topics)
    return found


def _joinable(found: list[Block], action: Action, entry: Entry) -> int | None:
    """Return the rule that an entry can join without overtaking one that its order matters to."""
    for at in range(len(found) - 1, -1, -1):
        block = found[at]
        if (block.effect, block.partitions) == (entry.effect, entry.partitions):
            return at
        if block.effect is not entry.effect:
            return None
        if any(not disjoint(old, new) for old in block.topics.get(action, ()) for new in entry.globs):
            return None
    return None


def standard_blocks(lowered: Lowered) -> tuple[Block, ...]:
    """Return rules that follow the standard as well as it goes, for what vendors do not read alike.

    All denials come first, then what is allowed, a rule for each list of partitions.
    """
    found: list[Block] = []
    for effect, sides in ((Effect.DENY, lowered.deny), (Effect.ALLOW, lowered.allow)):
        entries = [
            (action, Entry(effect, (pattern,), listed or (lists.EVERY if effect is Effect.DENY else DEFAULT)))
            for action in Action
            for pattern, listed in sides[action]
        ]
        found += _merged((), sorted(entries, key=lambda pair: pair[1].partitions))
    if not any(lowered.allow.values()):
        return ()
    return (Block(Effect.ALLOW, DEFAULT, {}), *found) if found[0].effect is Effect.DENY else tuple(found)
