# SPDX-License-Identifier: Apache-2.0
"""Lay out a bipartite graph: subjects and objects in columns, with few crossings; or a matrix of them.

Every label is inside its own box and every edge has its own port, so labels never overlap; boxes grow with their edges.
The order of rows follows the barycentre heuristic of layered drawing (Sugiyama, Tagawa, Toda 1981). The position of
subjects beside their objects is a least-squares fit with minimal distances (isotonic regression by pooling adjacent
violators).

A matrix has a row for each object, a column for each subject, and a sign for each edge. Where lines would hide each
other, signs do not: each has a place of its own, so it is clear whom it concerns.
"""

from __future__ import annotations

from bisect import bisect_right, insort
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from itertools import accumulate

from comarmor.text import natural_order
from comarmor.values import Data
from keymint.api.graph import DomainObject
from keymint.drawing.appearance import KINDS, columns, shorten
from keymint.drawing.labelled_graph import LabelledEdge

CHARACTER = 7.3
"""Width of a character of the labels, in pixels: at most 7.2 in a fixed-width font of 12 px."""
BOX_HEIGHT = 24.0
PORT_DISTANCE = 9.0
GAP = 10.0
"""Vertical distance between two boxes."""
PADDING, BULLET = 10.0, 14.0
"""Space beside a label, and for the dot before it."""
_ROUNDS = 16
_MARKED_HEIGHT = 40.0
_NARROWEST, _WIDEST = 150.0, 460.0

_SHARED_BY = 4
"""Objects of at least that many subjects get a column of their own."""

NodeKey = str | DomainObject
_Side = tuple[NodeKey, bool]
"""A node, and whether (True) its edges on this side go right from subject to object."""


class NodeBox(Data):
    """A subject or an object.

    Attributes:
        key: a subject's name, or an object's domain and the object.
        kind: ``subject``, or the object's kind.
        label: text inside the box.
        mark: a second line of text, or empty.
        x: left edge, in pixels.
        y: top edge.
        width: in pixels.
        height: in pixels.
    """

    key: NodeKey
    kind: str
    label: str
    x: float
    y: float
    width: float
    height: float
    mark: str = ""


class EdgeLine(Data):
    """An edge between its two ports; it leaves and reaches both horizontally.

    Attributes:
        labelled: the edge.
        x1: at the subject, in pixels.
        y1: at the subject.
        x2: at the object.
        y2: at the object.
    """

    labelled: LabelledEdge
    x1: float
    y1: float
    x2: float
    y2: float


class Panel(Data):
    """The layout of one graph, from (0, 0); in a matrix a line is a point, where the sign of its edge is."""

    boxes: tuple[NodeBox, ...]
    lines: tuple[EdgeLine, ...]
    width: float
    height: float
    heading: str = ""


def objects_in_order(edges: Iterable[LabelledEdge]) -> list[DomainObject]:
    """Return the objects of edges, by kind and name."""
    return sorted({one.edge.domain_object for one in edges}, key=_rank)


def lay_out(
    edges: Sequence[LabelledEdge], subjects: Sequence[str], names: Mapping[NodeKey, str], marks: Mapping[NodeKey, str]
) -> Panel:
    """Return the layout of a graph.

    Two subjects are placed on both sides of their objects. More than two are placed between the objects that many of
    them share, to the left, and all other objects, to the right.

    Args:
        edges: its edges.
        subjects: its subjects, including those without an edge.
        names: of its subjects and objects.
        marks: a second line of text for some subjects and objects.
    """
    objects = objects_in_order(edges)
    beside: dict[NodeKey, list[NodeKey]] = defaultdict(list)
    for one in edges:
        beside[one.edge.subject].append(one.edge.domain_object)
        beside[one.edge.domain_object].append(one.edge.subject)
    stacks = _columns(list(subjects), objects, {key: {*ends} for key, ends in beside.items()})
    column_of = {key: at for at, stack in enumerate(stacks) for key in stack}
    sides: dict[_Side, list[LabelledEdge]] = defaultdict(list)
    for one in edges:
        subject, object_ = one.edge.subject, one.edge.domain_object
        rightward = column_of[subject] < column_of[object_]
        sides[subject, rightward].append(one)
        sides[object_, rightward].append(one)
    heights = {
        key: max(
            _MARKED_HEIGHT if key in marks else BOX_HEIGHT,
            PORT_DISTANCE * (1 + max(len(sides[key, side]) for side in (False, True))),
        )
        for key in column_of
    }
    tops = _tops(stacks, heights, beside)

    labels = {key: shorten(names[key]) for key in column_of}
    gap = min(_WIDEST, max(_NARROWEST, 60.0 + 8.0 * len(edges) ** 0.75))
    boxes: dict[NodeKey, NodeBox] = {}
    x = 0.0
    for stack in stacks:
        longest = {key: max(columns(labels[key]), columns(marks.get(key, ""))) for key in stack}
        width = max((longest[key] * CHARACTER + 2 * PADDING + BULLET for key in stack), default=0.0)
        for key in stack:
            kind = "subject" if isinstance(key, str) else key[1].kind
            boxes[key] = NodeBox(key, kind, labels[key], x, tops[key], width, heights[key], marks.get(key, ""))
        x += width + gap
    height = max((box.y + box.height for box in boxes.values()), default=0.0)
    return Panel(tuple(boxes.values()), _lines(edges, boxes, sides), max(0.0, x - gap), height)


def _rank(key: DomainObject) -> tuple[object, ...]:
    return list(KINDS).index(key[1].kind), key[0], natural_order(key[1].name), key


# -- order -----------------------------------------------------------------------------------------------------------


def _columns(
    subjects: list[str], objects: list[DomainObject], beside: Mapping[NodeKey, set[NodeKey]]
) -> list[list[NodeKey]]:
    """Return the columns from left to right, each from top to bottom."""
    if len(subjects) == 2:  # noqa: PLR2004 - one on each side
        both = sorted(objects, key=lambda key: (len(beside[key]) < 2, _rank(key)))  # noqa: PLR2004
        return [[subjects[0]], list(both), [subjects[1]]]
    most = max(_SHARED_BY, 0.4 * len(subjects))
    hubs = [key for key in objects if len(beside[key]) >= most]
    others = [key for key in objects if len(beside[key]) < most]
    if not hubs or not others:
        return list(_ordered(subjects, objects, beside))
    return [list(hubs), *_ordered(subjects, others, beside)]


def _ordered(
    subjects: list[str], objects: list[DomainObject], beside: Mapping[NodeKey, set[NodeKey]]
) -> tuple[list[NodeKey], list[NodeKey]]:
    """Return two columns in the order with the fewest crossings in some rounds of the heuristic."""
    left: list[NodeKey] = list(subjects)
    right: list[NodeKey] = list(objects)
    best = (_crossings(left, right, beside), left, right)
    for _ in range(_ROUNDS):
        if best[0] == 0:
            break
        right = _by_mean(right, left, beside)
        left = _by_mean(left, right, beside)
        crossings = _crossings(left, right, beside)
        if crossings >= best[0]:
            break
        best = (crossings, left, right)
    return best[1], best[2]


def _by_mean(
    column: Sequence[NodeKey], other: Sequence[NodeKey], beside: Mapping[NodeKey, set[NodeKey]]
) -> list[NodeKey]:
    """Return a column sorted by the mean position of each node's neighbours; the sort is stable."""
    places = {key: at for at, key in enumerate(other)}

    def mean(key: NodeKey) -> float:
        neighbours = [places[one] for one in beside.get(key, ()) if one in places]
        return sum(neighbours) / len(neighbours) if neighbours else len(other)

    return sorted(column, key=mean)


def _crossings(left: Sequence[NodeKey], right: Sequence[NodeKey], beside: Mapping[NodeKey, set[NodeKey]]) -> int:
    """Return the number of pairs of edges that cross: the inversions of their ends."""
    at = {key: place for place, key in enumerate(right)}
    seen: list[int] = []
    crossings = 0
    for subject in left:
        ends = sorted(at[key] for key in beside.get(subject, ()) if key in at)
        crossings += sum(len(seen) - bisect_right(seen, end) for end in ends)
        for end in ends:
            insort(seen, end)
    return crossings


# -- positions ---------------------------------------------------------------------------------------------------------


def _tops(
    stacks: Sequence[Sequence[NodeKey]], heights: Mapping[NodeKey, float], beside: Mapping[NodeKey, Sequence[NodeKey]]
) -> dict[NodeKey, float]:
    """Return the upper edges of all boxes: the longest column is stacked, the others are fitted beside it."""
    longest = max(range(len(stacks)), key=lambda at: sum(heights[key] + GAP for key in stacks[at]))
    tops = _stacked(stacks[longest], heights)
    for at in sorted(range(len(stacks)), key=lambda at: abs(at - longest)):
        if at == longest:
            continue
        # The tops nearest to the middle of each node's neighbours (least squares) that keep order and gaps.
        shifts = _stacked(stacks[at], heights)
        blocks: list[tuple[float, int]] = []
        wanted = 0.0
        for key in stacks[at]:
            ends = [tops[one] + heights[one] / 2 for one in beside.get(key, ()) if one in tops]
            wanted = sum(ends) / len(ends) - heights[key] / 2 if ends else wanted
            mean, count = wanted - shifts[key], 1
            while blocks and blocks[-1][0] > mean:
                before, members = blocks.pop()
                mean, count = (before * members + mean * count) / (members + count), members + count
            blocks.append((mean, count))
        offsets = [mean for mean, count in blocks for _ in range(count)]
        tops |= {key: shifts[key] + offset for key, offset in zip(stacks[at], offsets, strict=True)}
    lowest = min(tops.values(), default=0.0)
    return {key: top - lowest for key, top in tops.items()}


def _stacked(column: Sequence[NodeKey], heights: Mapping[NodeKey, float]) -> dict[NodeKey, float]:
    return dict(zip(column, accumulate((heights[key] + GAP for key in column), initial=0.0), strict=False))


def _lines(
    edges: Sequence[LabelledEdge], boxes: Mapping[NodeKey, NodeBox], sides: Mapping[_Side, list[LabelledEdge]]
) -> tuple[EdgeLine, ...]:
    """Assign ports to every edge, in the order of the boxes at the other end so that edges do not cross at a box."""
    at: dict[tuple[NodeKey, LabelledEdge], float] = {}
    for (key, _), side in sides.items():

        def place(one: LabelledEdge, key: NodeKey = key) -> tuple[float, str]:
            return boxes[one.edge.domain_object if key == one.edge.subject else one.edge.subject].y, one.edge.permission

        middle = boxes[key].y + boxes[key].height / 2
        for number, one in enumerate(sorted(side, key=place)):
            at[key, one] = middle + (number - (len(side) - 1) / 2) * PORT_DISTANCE
    lines = []
    for one in edges:
        subject, object_ = boxes[one.edge.subject], boxes[one.edge.domain_object]
        x1, x2 = subject.x + subject.width, object_.x
        if subject.x >= object_.x:
            x1, x2 = subject.x, object_.x + object_.width
        lines.append(EdgeLine(one, x1, at[subject.key, one], x2, at[object_.key, one]))
    return tuple(lines)


# -- a matrix ---------------------------------------------------------------------------------------------------------

ROW = 22.0
"""Height of a row, in pixels."""
SIGN = 21.0
"""Width of a sign with the space beside it, in pixels."""
MOST_COLUMNS = 30
"""Subjects of a matrix: the eye does not follow longer rows."""


def lay_out_matrix(
    edges: Sequence[LabelledEdge], subjects: Sequence[str], names: Mapping[NodeKey, str], marks: Mapping[NodeKey, str]
) -> Panel:
    """Return the layout of a matrix; for the arguments see :func:`lay_out`."""
    objects = objects_in_order(edges)
    cells: dict[tuple[str, DomainObject], list[LabelledEdge]] = defaultdict(list)
    for one in edges:
        cells[one.edge.subject, one.edge.domain_object].append(one)

    keys: Sequence[NodeKey] = [*subjects, *objects]
    labels = {key: shorten(names[key]) + (f" ({marks[key]})" if key in marks else "") for key in keys}
    left = max((columns(labels[key]) for key in objects), default=0) * CHARACTER + 2 * PADDING + BULLET
    top = max((columns(labels[key]) for key in subjects), default=0) * CHARACTER + 2 * PADDING
    width = max(ROW, SIGN * max(map(len, cells.values()), default=1) + 3)
    boxes: dict[NodeKey, NodeBox] = {}
    for at, subject in enumerate(subjects):
        boxes[subject] = NodeBox(subject, "subject", labels[subject], left + at * width + 1, 0.0, width - 2, top - 2)
    for at, key in enumerate(objects):
        boxes[key] = NodeBox(key, key[1].kind, labels[key], 0.0, top + at * ROW + 1, left - 2, ROW - 2)
    lines: list[EdgeLine] = []
    for (subject, key), those in cells.items():
        x, y = boxes[subject].x + boxes[subject].width / 2, boxes[key].y + boxes[key].height / 2
        places = (x + (at - (len(those) - 1) / 2) * SIGN for at in range(len(those)))
        lines += (EdgeLine(one, place, y, place, y) for one, place in zip(those, places, strict=True))
    size = left + len(subjects) * width, top + len(objects) * ROW
    return Panel(tuple(boxes.values()), tuple(lines), *size)
