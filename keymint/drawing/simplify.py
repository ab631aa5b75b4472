"""What a picture draws of a graph: common rules as marks, large graphs in groups, no more lines than there is room.

What is allowed against the policy, and what a rule denies expressly, is always drawn.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from keymint.drawing.fold import fold
from keymint.drawing.grouping import GROUP_FROM, grouped, groups
from keymint.drawing.labelled_graph import EdgeOutcome, LabelledEdge, LabelledGraph
from keymint.drawing.layout import DomainObject
from keymint.drawing.options import DrawingOptions, Split

FOLD_FROM = 40
"""Objects of a graph from which on they are folded unless the reader wants otherwise."""


@dataclass(frozen=True, slots=True)
class SimplifiedGraph:
    """What is drawn of a graph.

    Attributes:
        edges: the lines, in their own order.
        groups: the subjects by what stands for them, which is the subject itself where nothing is grouped.
        marks: the common edges that are not drawn, by what stands for their subject.
        members: the objects that each object that is drawn stands for.
        left_out: lines that there was no room for.
    """

    edges: tuple[LabelledEdge, ...]
    groups: Mapping[str, tuple[str, ...]]
    marks: Mapping[str, tuple[LabelledEdge, ...]]
    members: Mapping[DomainObject, tuple[DomainObject, ...]]
    left_out: int


def simplify(labelled: LabelledGraph, options: DrawingOptions) -> SimplifiedGraph:
    """Return what is drawn of a graph."""
    folded = [one for one in labelled.edges if not options.common and is_folded(one, options)]
    hidden = set(folded)
    edges: Sequence[LabelledEdge] = [one for one in labelled.edges if one not in hidden]
    members: Mapping[str, tuple[str, ...]] = {subject: (subject,) for subject in labelled.subjects}
    if _wants_groups(labelled, options) and len(found := groups(labelled.subjects)) > 1:
        members, edges = found, grouped(edges, found)
    drawn, objects = _folded(edges, options)
    shown = shown_edges(drawn, options)
    marks: dict[str, list[LabelledEdge]] = defaultdict(list)
    group_of = {subject: name for name, subjects in members.items() for subject in subjects}
    for one in folded:
        marks[group_of[one.edge.subject]].append(one)
    return SimplifiedGraph(
        shown, members, {name: tuple(found) for name, found in marks.items()}, objects, len(drawn) - len(shown)
    )


def is_folded(one: LabelledEdge, options: DrawingOptions) -> bool:
    """Tell whether an edge is left to a mark: a common rule allows it, and so does the transport."""
    return one.common and one.outcome(options.transport) is EdgeOutcome.ALLOW


def _wants_groups(labelled: LabelledGraph, options: DrawingOptions) -> bool:
    if options.group is None:
        return options.split is Split.NONE and len(labelled.subjects) > GROUP_FROM
    return options.group


def _folded(
    edges: Sequence[LabelledEdge], options: DrawingOptions
) -> tuple[tuple[LabelledEdge, ...], Mapping[DomainObject, tuple[DomainObject, ...]]]:
    objects = {(one.edge.domain, one.edge.object) for one in edges}
    if options.fold or (options.fold is None and len(objects) >= FOLD_FROM):
        return fold(edges)
    return tuple(edges), {key: (key,) for key in objects}


def shown_edges(edges: Sequence[LabelledEdge], options: DrawingOptions) -> tuple[LabelledEdge, ...]:
    """Return the edges that a picture has room for, in their own order.

    Beyond the limit what no rule allows goes first, and all of it: some of it would look as if the rest were allowed.
    Then goes what is allowed. False labels and express denials stay, however many there are.
    """
    if len(edges) <= options.limit:
        return tuple(edges)
    weights = {one: weight(one, options.transport) for one in edges}
    needed = sum(found <= EXPRESS for found in weights.values())
    room = max(0, options.limit - needed)
    kept = []
    for one in edges:
        if weights[one] <= EXPRESS:
            kept.append(one)
        elif weights[one] < DEFAULT_DENIAL and room:
            room -= 1
            kept.append(one)
    return tuple(kept)


EXPRESS = 1
"""Weight of what is never left out, and above: false labels, and what a rule denies expressly."""
DEFAULT_DENIAL = 3
"""Weight of what matters least to a reader: no rule allows it."""


def weight(one: LabelledEdge, transport: int | None = None) -> int:
    """Return how much an edge matters to a reader; least first."""
    outcome = one.outcome(transport)
    if outcome.false:
        return 0
    if outcome is not EdgeOutcome.DENY:
        return 2
    return EXPRESS if one.policy is not None and one.policy.where is not None else DEFAULT_DENIAL
