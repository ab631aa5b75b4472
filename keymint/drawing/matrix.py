# SPDX-License-Identifier: Apache-2.0
"""Lay out a matrix: a row for each object, a column for each subject, and a sign for each edge.

Where lines would hide each other, signs do not: each has a place of its own, so it is clear whom it concerns.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence

from keymint.api.graph import DomainObject
from keymint.drawing.appearance import columns, shorten
from keymint.drawing.labelled_graph import LabelledEdge
from keymint.drawing.layout import CHARACTER, NodeBox, NodeKey, Panel, Sign, objects_in_order

ROW = 22.0
"""Height of a row, in pixels."""
SIGN = 21.0
"""Width of a sign with the space beside it, in pixels."""
_PADDING, _BULLET = 10.0, 14.0
MOST_COLUMNS = 30
"""Subjects of a matrix: the eye does not follow longer rows."""


def matrix_parts(heading: str, subjects: Sequence[str]) -> Iterator[tuple[str, Sequence[str]]]:
    """Yield the parts of a matrix that is too wide, each with its heading and its subjects."""
    for begin in range(0, len(subjects), MOST_COLUMNS):
        part = subjects[begin : begin + MOST_COLUMNS]
        yield heading + (f" {begin + 1} to {begin + len(part)}" if len(subjects) > MOST_COLUMNS else ""), part


def lay_out_matrix(
    heading: str,
    edges: Sequence[LabelledEdge],
    subjects: Sequence[str],
    names: Mapping[NodeKey, str],
    marks: Mapping[NodeKey, str],
) -> Panel:
    """Return the layout of a matrix; for the arguments see :func:`keymint.drawing.layout.lay_out`."""
    objects = objects_in_order(edges)
    cells: dict[tuple[str, DomainObject], list[LabelledEdge]] = defaultdict(list)
    for one in edges:
        cells[one.edge.subject, one.edge.domain_object].append(one)

    def label(key: NodeKey) -> str:
        return shorten(names[key]) + (f" ({mark})" if (mark := marks.get(key)) else "")

    above = {subject: label(subject) for subject in subjects}
    beside = {key: label(key) for key in objects}
    left = max(map(columns, beside.values()), default=0) * CHARACTER + 2 * _PADDING + _BULLET
    top = max(map(columns, above.values()), default=0) * CHARACTER + 2 * _PADDING
    width = max(ROW, SIGN * max(map(len, cells.values()), default=1) + 3)
    boxes = [
        NodeBox(subject, "subject", text, left + at * width + 1, 0.0, width - 2, top - 2)
        for at, (subject, text) in enumerate(above.items())
    ]
    boxes += [
        NodeBox(key, key[1].kind, text, 0.0, top + at * ROW + 1, left - 2, ROW - 2)
        for at, (key, text) in enumerate(beside.items())
    ]
    column = {subject: left + at * width for at, subject in enumerate(above)}
    row = {key: top + at * ROW for at, key in enumerate(beside)}
    signs = [
        Sign(one, column[subject] + width / 2 + (at - (len(those) - 1) / 2) * SIGN, row[key] + ROW / 2)
        for (subject, key), those in cells.items()
        for at, one in enumerate(those)
    ]
    return Panel(heading, tuple(boxes), (), left + len(above) * width, top + len(beside) * ROW, tuple(signs))
