# SPDX-License-Identifier: Apache-2.0
"""Lay out a matrix: a row for each object, a column for each subject, and a sign for each edge.

Where lines would hide each other, signs do not: each has a place of its own, so it is clear whom it concerns.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence

from keymint.api.graph import DomainObject
from keymint.drawing.appearance import columns, shorten
from keymint.drawing.labelled_graph import LabelledEdge
from keymint.drawing.layout import BULLET, CHARACTER, PADDING, EdgeLine, NodeBox, NodeKey, Panel, objects_in_order

ROW = 22.0
"""Height of a row, in pixels."""
SIGN = 21.0
"""Width of a sign with the space beside it, in pixels."""
MOST_COLUMNS = 30
"""Subjects of a matrix: the eye does not follow longer rows."""


def lay_out_matrix(
    edges: Sequence[LabelledEdge], subjects: Sequence[str], names: Mapping[NodeKey, str], marks: Mapping[NodeKey, str]
) -> Panel:
    """Return the layout of a matrix; for the arguments see :func:`keymint.drawing.layout.lay_out`."""
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
