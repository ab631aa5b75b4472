"""Draws labelled graphs as SVG, as the paper does: subjects green, topics blue, services purple, edges by role."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cache
from typing import TYPE_CHECKING

from keymint.pictures.fold import fold, folded_name
from keymint.pictures.layout import CHARACTER, Box, Domain, Key, Line, Panel, lay_out
from keymint.pictures.legend import LINE, edge_classes, flowed, legend
from keymint.pictures.model import Labelled, LabelledEdge, Outcome, namespace
from keymint.pictures.palette import Theme, style_sheet
from keymint.pictures.text import columns, object_name, printable, shorten
from keymint.pictures.words import counted, sentence

if TYPE_CHECKING:
    from jinja2 import Environment

MARGIN = 24.0
_PANEL_GAP = 48.0
_SHEET = 1500.0
"""Panels stand beside one another up to that width, in pixels."""
_LEAST_WIDTH = 760.0
_HEAD = 8.0
_LEAST = 2
"""Weight of what matters least to a reader: what is denied, and rightly."""
FOLD_FROM = 40
"""Objects of a graph from which on they are folded unless the reader wants otherwise."""


_Members = Mapping[Domain, tuple[Domain, ...]]


class Split(StrEnum):
    """Into which panels a picture is divided."""

    NONE = "none"
    SUBJECT = "subject"
    NAMESPACE = "namespace"


@dataclass(frozen=True, slots=True)
class Options:
    """How a graph is drawn.

    Attributes:
        theme: colours.
        split: one panel, or one per subject or namespace of subjects.
        transport: index of the transport whose labels are drawn; None for all together.
        limit: the most edges that are drawn; see :func:`shown_edges`. The picture says what it leaves out.
        fold: draw objects that nothing tells apart as one; None does so from :data:`FOLD_FROM` objects on.
    """

    theme: Theme = Theme.AUTO
    split: Split = Split.NONE
    transport: int | None = None
    limit: int = 600
    fold: bool | None = None


@dataclass(frozen=True, slots=True)
class Embedding:
    """How a picture becomes part of a page, which has the style sheet.

    Attributes:
        number: returns the number of a subject or object in the page, which says more about it under ``#n<number>``.
    """

    number: Callable[[Key], int]


@cache
def environment() -> Environment:
    """Return the templates; everything that they print is escaped."""
    from jinja2 import Environment, PackageLoader, StrictUndefined  # noqa: PLC0415 - slow, only for pictures

    return Environment(
        loader=PackageLoader("keymint.pictures"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )


def svg(labelled: Labelled, options: Options | None = None) -> bytes:
    """Return a picture as an SVG 1.1 document in UTF-8; the same for the same graph on every machine.

    Args:
        labelled: the graph.
        options: how it is drawn.
    """
    return draw(labelled, options or Options(), None).encode()


def draw(labelled: Labelled, options: Options, embedding: Embedding | None) -> str:
    """Return a picture as a document, or as an element to embed."""
    edges, members = _folded(labelled.edges, options)
    total = len(edges)
    edges = shown_edges(edges, options)
    names = {key[1]: folded_name(found) for key, found in members.items() if len(found) > 1}
    panels = [lay_out(*part, names) for part in _parts(labelled, edges, options.split)]
    samples = list(legend(labelled, edges, panels, options.transport))
    width = max(_LEAST_WIDTH, *(panel.width for panel in panels)) if panels else _LEAST_WIDTH
    placed, sheet_width, sheet_height = _placed(panels, max(width, _SHEET) if len(panels) > 1 else width)
    width = max(sheet_width, _LEAST_WIDTH)
    samples, legend_height = flowed(samples, width)
    top = MARGIN + 2 * LINE
    legend_top = top + 4
    panel_top = legend_top + legend_height + 18
    left = MARGIN + (max(0.0, width - sheet_width) / 2)
    return (
        environment()
        .get_template("picture.svg.j2")
        .render(
            title=printable(labelled.title),
            heading=shorten(printable(labelled.title), int(width / (CHARACTER * 15 / 12))),
            subtitle=_subtitle(labelled, options, members, len(edges), total),
            style=None if embedding else style_sheet(options.theme),
            standalone=embedding is None,
            width=_number(width + 2 * MARGIN),
            height=_number(panel_top + sheet_height + MARGIN),
            margin=MARGIN,
            legend=samples,
            legend_top=legend_top,
            rule_y=_number(panel_top - 12),
            panels=[
                {
                    "heading": panel.heading,
                    "x": _number(left + x),
                    "y": _number(panel_top + y),
                    "lines": [
                        _line(line, labelled, options, members, embedding) for line in _by_weight(panel.lines, options)
                    ],
                    "boxes": [_box(box, labelled, members, embedding) for box in panel.boxes],
                }
                for panel, x, y in placed
            ],
        )
    )


def _folded(
    edges: Sequence[LabelledEdge], options: Options
) -> tuple[tuple[LabelledEdge, ...], dict[Domain, tuple[Domain, ...]]]:
    objects = {(one.edge.domain, one.edge.object) for one in edges}
    if options.fold or (options.fold is None and len(objects) >= FOLD_FROM):
        return fold(edges)
    return tuple(edges), {key: (key,) for key in objects}


def shown_edges(edges: Sequence[LabelledEdge], options: Options) -> tuple[LabelledEdge, ...]:
    """Return the edges that a picture has room for, in their own order.

    Beyond the limit true denials go first, and all of them: some of them would look as if the others were allowed.
    """
    if len(edges) <= options.limit:
        return tuple(edges)
    weights = {one: weight(one.outcome(options.transport)) for one in edges}
    kept = [one for one in edges if weights[one] < _LEAST]
    if len(kept) > options.limit:
        chosen = set(sorted(kept, key=weights.__getitem__)[: options.limit])
        kept = [one for one in kept if one in chosen]
    return tuple(kept)


def weight(outcome: Outcome) -> int:
    """Return how much an outcome matters to a reader; least first."""
    return 0 if outcome.false else _LEAST if outcome is Outcome.DENY else 1


def _by_weight(lines: Sequence[Line], options: Options) -> list[Line]:
    """Return lines so that those that matter are drawn over the others."""
    return sorted(lines, key=lambda line: -weight(line.labelled.outcome(options.transport)))


def _parts(
    labelled: Labelled, edges: Sequence[LabelledEdge], split: Split
) -> Iterator[tuple[str, tuple[LabelledEdge, ...], tuple[str, ...]]]:
    if split is Split.NONE:
        yield "", tuple(edges), labelled.subjects
        return
    members: dict[str, list[str]] = defaultdict(list)
    for subject in labelled.subjects:
        members[subject if split is Split.SUBJECT else namespace(subject)].append(subject)
    part_of = {subject: part for part, subjects in members.items() for subject in subjects}
    found: dict[str, list[LabelledEdge]] = defaultdict(list)
    for one in edges:
        found[part_of[one.edge.subject]].append(one)
    for part, subjects in members.items():
        yield printable(part), tuple(found[part]), tuple(subjects)


def _placed(panels: Sequence[Panel], most: float) -> tuple[list[tuple[Panel, float, float]], float, float]:
    """Place panels in rows; return them with their places, and the size of all."""
    placed = []
    x = y = tallest = widest = 0.0
    for panel in panels:
        width = max(panel.width, columns(panel.heading) * CHARACTER * 13 / 12)
        if x and x + width > most:
            x, y, tallest = 0.0, y + tallest + _PANEL_GAP, 0.0
        heading = LINE if panel.heading else 0.0
        placed.append((panel, x, y + heading))
        widest = max(widest, x + width)
        tallest = max(tallest, panel.height + heading)
        x += width + _PANEL_GAP
    return placed, widest, y + tallest


# -- words -----------------------------------------------------------------------------------------------------------


def _subtitle(labelled: Labelled, options: Options, members: _Members, drawn: int, total: int) -> str:
    objects = {(one.edge.domain, one.edge.object) for one in labelled.edges}
    sizes = ((labelled.subjects, "subject"), (objects, "object"), (labelled.edges, "edge"))
    said = [", ".join(counted(len(found), noun) for found, noun in sizes)]
    if labelled.transports:
        which = "all transports" if options.transport is None else labelled.transports[options.transport]
        if options.transport is None and len(labelled.transports) == 1:
            which = labelled.transports[0]
        false = sum(one.outcome(options.transport).false for one in labelled.edges)
        said.append(f"{printable(which)} against the policy: {false or 'no'} false label{'s' if false != 1 else ''}")
    if any(len(found) > 1 for found in members.values()):
        said.append("objects that are alike are drawn as one")
    if drawn < total:
        said.append(f"{total - drawn} of {total} lines left out, first what is rightly denied")
    return "; ".join(said)


# -- shapes ----------------------------------------------------------------------------------------------------------


def _box(box: Box, labelled: Labelled, members: _Members, embedding: Embedding | None) -> dict[str, object]:
    stands_for: Sequence[Key] = (box.key,) if isinstance(box.key, str) else members[box.key]
    title = box.title
    if not isinstance(box.key, str) and len(stands_for) > 1:
        title = "\n".join(object_name(found, domain) for domain, found in members[box.key])
    pattern = not isinstance(box.key, str) and box.key[1] in labelled.patterns
    return {
        "classes": f"box {box.kind}" + (" pattern" if pattern else ""),
        "title": title + (", an expression of the policy" if pattern else ""),
        "label": box.label,
        "x": _number(box.x),
        "y": _number(box.y),
        "width": _number(box.width),
        "height": _number(box.height),
        "bullet": box.kind != "subject",
        "text_x": _number(box.x + (10 if box.kind == "subject" else 22)),
        "text_y": _number(box.y + box.height / 2 + 4.2),
        "middle": _number(box.y + box.height / 2),
        "number": embedding.number(box.key) if embedding else None,
        "numbers": " ".join(str(embedding.number(key)) for key in stands_for) if embedding else None,
    }


def _line(
    line: Line, labelled: Labelled, options: Options, members: _Members, embedding: Embedding | None
) -> dict[str, object]:
    outcome = line.labelled.outcome(options.transport)
    size = _HEAD * (1.25 if outcome.false else 1.0)
    forward = math.copysign(1.0, line.x2 - line.x1)
    start = line.x1 + (size * forward if line.inward else 0.0)
    end = line.x2 - (size * forward if line.outward else 0.0)
    bend = 0.45 * (end - start)
    curve = f"M{_number(start)} {_number(line.y1)}C{_number(start + bend)} {_number(line.y1)} "
    curve += f"{_number(end - bend)} {_number(line.y2)} {_number(end)} {_number(line.y2)}"
    barred = outcome is not Outcome.UNLABELLED and not outcome.allowed
    heads = []
    if line.outward:
        heads.append(_head(line.x2, line.y2, forward * size, barred=barred))
    if line.inward:
        heads.append(_head(line.x1, line.y1, -forward * size, barred=barred))
    edge = line.labelled.edge
    at = 0.11
    return {
        "outcome": str(outcome),
        "classes": f"edge {edge_classes(outcome, labels=bool(labelled.transports))}",
        "title": sentence(line.labelled, labelled.transports),
        "curve": curve,
        "heads": "".join(heads),
        "audit": line.labelled.audit,
        "dot_x": _number(start + (end - start) * (at**3 + 3 * at**2 * (1 - at) * 0.55 + 3 * at * (1 - at) ** 2 * 0.45)),
        "dot_y": _number(line.y1 + (line.y2 - line.y1) * (at**3 + 3 * at**2 * (1 - at))),
        "subject": embedding.number(edge.subject) if embedding else None,
        "object": " ".join(str(embedding.number(key)) for key in members[edge.domain, edge.object])
        if embedding
        else None,
    }


def _head(x: float, y: float, size: float, *, barred: bool) -> str:
    """Return an arrowhead with its tip at (x, y); ``size`` is its length, negative when it points to the left."""
    half = abs(size) * 0.45
    head = f"M{_number(x)} {_number(y)}l{_number(-size)} {_number(-half)}v{_number(2 * half)}z"
    if barred:
        head += f"M{_number(x - 1.45 * size)} {_number(y - half)}v{_number(2 * half)}"
    return head


def _number(value: float) -> str:
    return f"{value:.1f}".removesuffix(".0")
