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

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from comarmor.patterns.glob import Glob
from comarmor.patterns.relations import TooComplexError, all_disjoint, intersection, union_covers
from comarmor.rules import Effect
from keymint.ir import Rule
from keymint.keymake.order import EarlyRules, early_rules
from keymint_ros2_dds.compiling.partitions import DEFAULT, EVERY, Entry
from keymint_ros2_dds.compiling.plans import Plan, denial_of, plans
from keymint_ros2_dds.lowering.lower import Lowered, Partitions
from keymint_ros2_dds.lowering.mapping import Action


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


_Tagged = tuple[Action, Entry]
_Sides = Mapping[Action, Sequence[Plan]]


def blocks(lowered: Lowered, *, reduced: bool = True) -> tuple[Block, ...]:
    """Return the rules of a grant; none when nothing is allowed.

    Args:
        lowered: what is allowed and denied.
        reduced: leave out patterns that change nothing.

    Raises:
        OrderError: Cyclone DDS and the standard would read every order differently.
        PartitionError: partitions cannot be said alike for all vendors.
    """
    sides = {
        action: plans(tuple(lowered.allow[action]), tuple(lowered.deny[action]), reduced=reduced) for action in Action
    }
    relay = sides.pop(Action.RELAY)
    relays = [(Action.RELAY, entry) for part in ("front", "back") for plan in relay for entry in getattr(plan, part)]
    found = [*_both(sides), *_merged(relays)]
    if found and found[0].effect is Effect.DENY:
        found.insert(0, Block(Effect.ALLOW, DEFAULT, {}))
    return tuple(found)


def _both(sides: _Sides) -> list[Block]:
    """Return the rules for both directions, in the shortest of the orders in which every vendor reads them alike."""
    front = _tagged(sides, "front")
    if not _tagged(sides, "back"):
        return _merged(front)
    publish, subscribe = Action.PUBLISH, Action.SUBSCRIBE
    attempts: list[tuple[tuple[Action, ...], tuple[Action, ...]]]
    attempts = [((publish, subscribe), (subscribe,)), ((subscribe, publish), (publish,))]
    if all(plan.order for plan in (*sides[publish], *sides[subscribe])):
        attempts.insert(0, ((), (publish, subscribe)))
    candidates: list[list[Block]] = []
    refused: OrderError | None = None
    for order, rescued in attempts:
        try:
            rescue = [item for action in rescued for item in _rescues(action, sides)]
        except OrderError as error:
            refused = error
            continue
        if order or not any(each.dirty for _, _, each in rescue):
            back = _in_turn(sides, order) if order else _together(sides)
            candidates.append([*_first(front, rescue), *back])
    if not candidates and refused:
        raise refused
    return min(candidates, key=_cost)


def _cost(found: Iterable[Block]) -> int:
    """Return about how large rules are: a rule weighs as much as two patterns."""
    return sum(2 + sum(map(len, block.topics.values())) for block in found)


def _tagged(sides: _Sides, part: str) -> list[_Tagged]:
    return [(action, entry) for action, listed in sides.items() for plan in listed for entry in getattr(plan, part)]


def _rescues(action: Action, sides: _Sides) -> list[tuple[Action, Plan, EarlyRules]]:
    """Return what one direction must allow before the other one's denials are read.

    Raises:
        OrderError: that cannot be said.
    """
    other = Action.SUBSCRIBE if action is Action.PUBLISH else Action.PUBLISH
    denies = [glob for plan in sides[other] for glob in plan.denies]
    said = [glob for _, entry in _tagged(sides, "front") for glob in entry.globs]
    found: list[tuple[Action, Plan, EarlyRules]] = []
    for plan in sides[action]:
        try:
            if plan.order:
                found.append((action, plan, early_rules(denies, plan.order)))
            elif clash := _clash(denies, plan, said):
                reason = (
                    "it is denied in one direction, allowed in the other, and narrowed to several lists of partitions: "
                    "Cyclone DDS up to 0.10 lets the denial decide for both directions"
                )
                raise OrderError(clash, reason)
        except TooComplexError:
            raise OrderError(denies[0], "it overlaps what the other direction allows in too many ways") from None
    return found


def _clash(denies: Iterable[Glob], plan: Plan, said: Iterable[Glob]) -> Glob | None:
    """Return a denied pattern that a detailed list allows names of which nothing was said yet, or None."""
    known = list(said)
    for entry in plan.back:
        if entry.effect is Effect.DENY:
            known.extend(entry.globs)
            continue
        for deny in denies:
            pieces = (piece for allow in entry.globs for piece in intersection(deny, allow))
            if any(not union_covers(tuple(known), piece, 2000) for piece in pieces):
                return deny
    return None


def _first(front: Iterable[_Tagged], rescues: Iterable[tuple[Action, Plan, EarlyRules]]) -> list[Block]:
    """Return the rules for what no denial touches, and for what must be allowed before the others' denials."""
    rescues = [item for item in rescues if item[2].clean or item[2].dirty]
    clean = [(action, Entry(Effect.ALLOW, each.clean, plan.partitions)) for action, plan, each in rescues if each.clean]
    found = _merged([*front, *clean])
    for action, plan, each in rescues:
        if each.dirty:
            found.append(Block(Effect.DENY, denial_of(plan.partitions), {action: each.deny}))
            found.append(Block(Effect.ALLOW, plan.partitions, {action: each.dirty}))
    return found


def _in_turn(sides: _Sides, order: Sequence[Action]) -> list[Block]:
    """Return the rules of one direction, then those of the other."""
    return [block for action in order for block in _merged(_denials_first({action: sides[action]}))]


def _together(sides: _Sides) -> list[Block]:
    """Return rules that deny, and then allow, in both directions at once."""
    return _merged(_denials_first(sides))


def _denials_first(sides: _Sides) -> list[_Tagged]:
    """Return the later steps of all plans: of the simple ones the denials first, then the detailed ones."""
    simple = [
        (action, entry) for action, listed in sides.items() for plan in listed if plan.order for entry in plan.back
    ]
    detailed = [
        (action, entry) for action, listed in sides.items() for plan in listed if not plan.order for entry in plan.back
    ]
    return [*sorted(simple, key=lambda pair: pair[1].effect is Effect.ALLOW), *detailed]


def _merged(entries: Iterable[_Tagged]) -> list[Block]:
    """Turn entries into rules; neighbours with the same effect and partitions share one."""
    found: list[Block] = []
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
        if not all_disjoint(block.topics.get(action, ()), entry.globs):
            return None
    return None


def one_by_one(found: Iterable[Block], lowered: Lowered) -> tuple[Block, ...]:
    """Return rules of a grant with a rule for each rule of the policy, in the place of those that had several in one.

    What stands in one rule has one effect and one list of partitions, so that it may stand in several as well.
    """
    owners: dict[tuple[Effect, Action, Glob], Rule] = {}
    for effect, sides in ((Effect.ALLOW, lowered.allow), (Effect.DENY, lowered.deny)):
        for action in Action:
            for (pattern, _), rule in sides[action].items():
                owners.setdefault((effect, action, pattern), rule)
    parts: list[Block] = []
    for block in found:
        own: dict[Rule | None, dict[Action, list[Glob]]] = {}
        for action, globs in block.topics.items():
            for glob in globs:
                owner = owners.get((block.effect, action, glob))
                own.setdefault(owner, {}).setdefault(action, []).append(glob)
        for topics in own.values() if own else ({},):
            said = {action: tuple(globs) for action, globs in topics.items()}
            parts.append(Block(block.effect, block.partitions, said))
    return tuple(parts)


def standard_blocks(lowered: Lowered) -> tuple[Block, ...]:
    """Return rules that follow the standard as well as it goes, for what vendors do not read alike.

    All denials come first, then what is allowed, a rule for each list of partitions.
    """
    found: list[Block] = []
    for effect, sides in ((Effect.DENY, lowered.deny), (Effect.ALLOW, lowered.allow)):
        entries = [
            (action, Entry(effect, (pattern,), listed or (EVERY if effect is Effect.DENY else DEFAULT)))
            for action in Action
            for pattern, listed in sides[action]
        ]
        found += _merged(sorted(entries, key=lambda pair: pair[1].partitions))
    if not any(lowered.allow.values()):
        return ()
    return (Block(Effect.ALLOW, DEFAULT, {}), *found) if found[0].effect is Effect.DENY else tuple(found)
