"""One action's decision lists: a simple one for each list of partitions, and a detailed one where lists meet."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from comarmor.patterns.glob import Glob, literal
from comarmor.patterns.relations import disjoint, sort_key
from comarmor.rules import Effect
from keymint.keymake.order import Arrangement, arrange
from keymint_ros2_dds.compiling.partitions import DEFAULT, EVERY, Entry, decision_list, touches, uniform
from keymint_ros2_dds.lowering.lower import Partitions

Listed = tuple[Glob, Partitions]


@dataclass(frozen=True, slots=True)
class Plan:
    """A decision list for patterns that no other plan of the same action shares a name with.

    Attributes:
        front: steps that no denial touches; they may be said before anything else.
        back: the steps from the first denial on.
        partitions: the list that all that is allowed shares.
        order: what the steps were made of, where they share a list; None for a detailed list.
    """

    front: tuple[Entry, ...]
    back: tuple[Entry, ...]
    partitions: Partitions
    order: Arrangement | None

    @property
    def denies(self) -> tuple[Glob, ...]:
        """What is denied."""
        return tuple(glob for entry in self.back if entry.effect is Effect.DENY for glob in entry.globs)


def plans(allow: Sequence[Listed], deny: Sequence[Listed], *, reduced: bool = True) -> list[Plan]:
    """Return the plans of an action; what each allows, the others say nothing of.

    Args:
        allow: what is allowed.
        deny: what is denied.
        reduced: leave out the patterns of simple lists that change nothing.

    Raises:
        PartitionError: partitions cannot be said alike for all vendors.
    """
    if not any(listed for _, listed in (*allow, *deny)):
        return [_simple(allow, deny, DEFAULT, reduced=reduced)]
    allow, deny = sorted(allow, key=_sort_key), sorted(deny, key=_sort_key)
    found: list[Plan] = []
    simple: dict[Partitions, tuple[list[Listed], list[Listed]]] = {}
    for allowed, denied in _components(allow, deny):
        try:
            shared = uniform(allowed, denied)
        except ValueError:  # a name is taken out of every partition; the detailed list says where
            shared = None
        if shared is None:
            entries = decision_list(allowed, denied)
            end = next((at for at, entry in enumerate(entries) if entry.effect is Effect.DENY), len(entries))
            found.append(Plan(entries[:end], entries[end:], EVERY, None))
        else:
            group = simple.setdefault(shared, ([], []))
            group[0].extend(allowed)
            group[1].extend(denied)
    return [*(_simple(*simple[shared], shared, reduced=reduced) for shared in sorted(simple)), *found]


def _sort_key(item: Listed) -> tuple[str, Partitions]:
    return sort_key(item[0]), item[1]


def _simple(allow: Iterable[Listed], deny: Iterable[Listed], shared: Partitions, *, reduced: bool) -> Plan:
    denied = (pattern for pattern, listed in deny if touches(shared, listed))
    order = arrange((pattern for pattern, _ in allow), dict.fromkeys(denied), reduced=reduced)
    front = (Entry(Effect.ALLOW, order.free, shared),) if order.free else ()
    back = (
        (Entry(Effect.DENY, order.deny, denial_of(shared)), Entry(Effect.ALLOW, order.rest, shared))
        if order.rest
        else ()
    )
    return Plan(front, back, shared, order)


def denial_of(shared: Partitions) -> Partitions:
    """Return the partitions of a deny rule: Cyclone DDS takes one without to be about the default partition alone."""
    return DEFAULT if shared == DEFAULT else EVERY


def _components(allow: Sequence[Listed], deny: Sequence[Listed]) -> Iterator[tuple[list[Listed], list[Listed]]]:
    """Yield what is allowed in groups that share no name, each with the denials that touch it.

    A denial that is narrowed to partitions ties what it touches together: it may mean something else for each list.
    """
    groups: list[list[Listed]] = []
    narrowed = [pattern for pattern, listed in deny if listed]
    literals = {pattern for pattern, _ in (*allow, *deny) if literal(pattern) is not None}
    loners: dict[Glob, list[Listed]] = {}
    wild = [p for p in (*(p for p, _ in allow), *narrowed) if p not in literals]
    for item in allow:
        if item[0] in literals and all(disjoint(item[0], other) for other in wild):
            loners.setdefault(item[0], []).append(item)
        else:
            tied = [group for group in groups if any(_tied(item[0], other, narrowed) for other, _ in group)]
            groups = [group for group in groups if group not in tied]
            groups.append([item, *(each for group in tied for each in group)])
    for group in (*loners.values(), *groups):
        yield group, [(d, listed) for d, listed in deny if any(not disjoint(d, p) for p, _ in group)]


def _tied(left: Glob, right: Glob, narrowed: Iterable[Glob]) -> bool:
    return not disjoint(left, right) or any(not disjoint(left, d) and not disjoint(right, d) for d in narrowed)
