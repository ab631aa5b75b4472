# SPDX-License-Identifier: Apache-2.0
"""Draw labelled graphs as SVG, as the paper does: subjects green, topics blue, services purple, edges by role."""

from __future__ import annotations

import math
import re
import textwrap
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cache
from itertools import chain
from typing import TYPE_CHECKING

from comarmor.text import one_line
from comarmor.values import replace
from keymint.api.graph import EdgeOutcome
from keymint.drawing.appearance import (
    DARK,
    FONTS,
    INWARD,
    KIND_NAMES,
    KINDS,
    LIGHT,
    OUTCOMES,
    OUTWARD,
    SIGNS,
    Theme,
    columns,
    directions,
    edge_classes,
    object_name,
    role,
    sentence,
    shorten,
)
from keymint.drawing.captions import marks_of, names_of, subtitle
from keymint.drawing.labelled_graph import LabelledEdge, LabelledGraph, namespace
from keymint.drawing.layout import CHARACTER, MOST_COLUMNS, EdgeLine, NodeBox, NodeKey, Panel, lay_out, lay_out_matrix
from keymint.drawing.simplify import DrawingOptions, Members, SimplifiedGraph, Split, priority, simplify

if TYPE_CHECKING:
    from jinja2 import Environment
    from markupsafe import Markup

MARGIN = 24.0
LINE = 22.0
"""Height of a line of text, in pixels."""
_PANEL_GAP = 48.0
_SHEET = 1700.0
"""Maximum width of a row of panels, in pixels."""
_LEAST_WIDTH = 760.0
_HEAD = 8.0
_BEND = 0.45
"""How far the control points of a curve (cubic Bézier) are from its ends, as a part of its width."""
_AT = 0.11
_DOT_ACROSS = _AT**3 + 3 * _AT**2 * (1 - _AT) * (1 - _BEND) + 3 * _AT * (1 - _AT) ** 2 * _BEND
_DOT_DOWN = _AT**3 + 3 * _AT**2 * (1 - _AT)
"""Where the dot of an AUDIT rule is on a curve, as parts of its width and height."""

LegendEntry = tuple[str, str, str]
"""An entry of the legend: its text, its classes of the style sheet, and what is drawn beside the text.

That is a ``box``, ``dot``, ``sign``, ``arrow``, ``barred``, ``both`` or the text of a mark.
"""
_MOST_NAMES = 40
"""Names in the tooltip of a box."""
NodeNumber = Callable[[NodeKey], int]
"""Returns the number of a subject, group or object in a page, which describes it at ``#n<number>``."""


@cache
def environment() -> Environment:
    """Return the template environment; every text that it prints is escaped, and one line of printable characters."""
    from jinja2 import Environment, PackageLoader, StrictUndefined  # noqa: PLC0415 - slow, only for pictures
    from markupsafe import Markup  # noqa: PLC0415 - as above

    def breakable(name: str) -> Markup:
        """Return a name as HTML in which lines can break only after ``/`` and ``_``."""
        return Markup("<wbr>").join(re.split("(?<=[^/_][/_])(?=[^/_])", one_line(name), flags=re.DOTALL))

    templates = Environment(
        loader=PackageLoader("keymint.drawing"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        finalize=lambda value: one_line(value) if type(value) is str else value,
    )

    def dot(text: str) -> Markup:
        r"""Return the inside of a quoted string of DOT; an unescaped ``\` starts an escape in a label."""
        return Markup(one_line(text).replace("\\", "\\\\").replace('"', '\\"'))  # noqa: S704 - it is no HTML

    templates.filters |= {"breakable": breakable, "dot": dot, "lines": Markup("\n").join, "px": _number}
    return templates


def style_sheet(theme: Theme) -> str:
    """Return the style sheet of a picture; renderers without media queries can read it, too."""
    palettes = {Theme.AUTO: (LIGHT, DARK), Theme.LIGHT: (LIGHT,), Theme.DARK: (DARK,)}[theme]
    return from_template("picture.css.j2", fonts=FONTS, kinds=KIND_NAMES, palettes=palettes)


def from_template(template: str, **context: object) -> str:
    """Return a template filled in; texts are escaped."""
    return environment().get_template(template).render(context)


def svg(labelled: LabelledGraph, options: DrawingOptions | None = None) -> bytes:
    """Return a picture as an SVG 1.1 document in UTF-8; deterministic on every machine.

    Args:
        labelled: the graph.
        options: drawing options.
    """
    return draw(simplify(labelled, options or DrawingOptions())).encode()


def draw(drawn: SimplifiedGraph, number: NodeNumber | None = None) -> str:
    """Return a picture as a document, or as an element to embed in a page that has the style sheet."""
    labelled, options = drawn.labelled, drawn.options
    names, marks = names_of(drawn), marks_of(drawn)
    lay = lay_out_matrix if drawn.matrices else lay_out
    panels = [replace(lay(edges, subjects, names, marks), heading=title) for title, edges, subjects in _parts(drawn)]
    width = max((_LEAST_WIDTH, *(panel.width for panel in panels)))
    widths = [max(panel.width, columns(panel.heading) * CHARACTER * 13 / 12) for panel in panels]
    headings = [LINE if panel.heading else 0.0 for panel in panels]
    heights = [panel.height + heading for panel, heading in zip(panels, headings, strict=True)]
    most = max(width, _SHEET) if len(panels) > 1 else width
    places, sheet_width, sheet_height = _in_rows(zip(widths, heights, strict=True), most, _PANEL_GAP)
    width = max(sheet_width, _LEAST_WIDTH)
    entries = [*legend(drawn, panels)]
    samples, _, legend_height = _in_rows([(58 + columns(text) * CHARACTER, LINE) for text, _, _ in entries], width, 0.0)
    caption = subtitle(drawn)
    subtitles = textwrap.wrap(caption, int(width / CHARACTER), break_long_words=False, break_on_hyphens=False)
    top = MARGIN + (1 + len(subtitles)) * LINE
    legend_top = top + 4
    panel_top = legend_top + legend_height + 18
    bottom = panel_top + sheet_height + MARGIN
    made = [line for text in labelled.made for line in textwrap.wrap(one_line(text), int(width / CHARACTER))]
    left = MARGIN + (max(0.0, width - sheet_width) / 2)

    def rank(line: EdgeLine) -> int:
        """Return when a line is drawn: the most important ones last, above the others."""
        return 0 if drawn.matrices else -priority(line.labelled, options.transport)

    return from_template(
        "picture.svg.j2",
        drawn=drawn,
        heading=shorten(one_line(labelled.title), int(width / (CHARACTER * 15 / 12))),
        subtitle=caption,
        subtitles=[(text, MARGIN + 34 + at * LINE) for at, text in enumerate(subtitles)],
        style=None if number else style_sheet(options.theme),
        width=_number(width + 2 * MARGIN),
        height=_number(bottom + len(made) * LINE),
        made=[(text, bottom + 6 + at * LINE) for at, text in enumerate(made)],
        margin=MARGIN,
        legend=[*zip(entries, samples, strict=True)],
        legend_top=legend_top,
        rule_y=panel_top - 12,
        panels=[
            {
                "heading": panel.heading,
                "x": left + x,
                "y": panel_top + y + heading,
                "edges": [_edge(line, drawn, number) for line in sorted(panel.lines, key=rank)],
                "boxes": [_box(box, drawn, number) for box in panel.boxes],
                "width": panel.width,
            }
            for panel, (x, y), heading in zip(panels, places, headings, strict=True)
        ],
    )


def _parts(drawn: SimplifiedGraph) -> Iterator[tuple[str, tuple[LabelledEdge, ...], tuple[str, ...]]]:
    split = drawn.options.split
    if split is Split.NONE and not drawn.matrices:
        yield "", tuple(drawn.stands), tuple(drawn.fold.subjects)
        return
    members: dict[str, list[str]] = defaultdict(list)
    for subject in drawn.fold.subjects:
        members[subject if split is Split.SUBJECT else namespace(subject)].append(subject)
    edges: dict[str, list[LabelledEdge]] = defaultdict(list)
    for one in drawn.stands:
        edges[one.edge.subject].append(one)
    for part, every in members.items():
        most = MOST_COLUMNS if drawn.matrices else len(every)
        for begin in range(0, len(every), most):
            subjects = tuple(every[begin : begin + most])
            heading = one_line(part) + (f" {begin + 1} to {begin + len(subjects)}" if len(every) > most else "")
            yield heading, tuple(one for subject in subjects for one in edges[subject]), subjects


def _in_rows(
    sizes: Iterable[tuple[float, float]], most: float, gap: float
) -> tuple[list[tuple[float, float]], float, float]:
    """Return the positions of rectangles in rows of at most a width, and the total width and height, in pixels."""
    places = []
    x = y = tallest = widest = 0.0
    for width, height in sizes:
        if x and x + width > most:
            x, y, tallest = 0.0, y + tallest + gap, 0.0
        places.append((x, y))
        widest = max(widest, x + width)
        tallest = max(tallest, height)
        x += width + gap
    return places, widest, y + tallest


# -- shapes ----------------------------------------------------------------------------------------------------------


def _box(box: NodeBox, drawn: SimplifiedGraph, number: NodeNumber | None) -> dict[str, object]:
    key, labelled = box.key, drawn.labelled
    members = [*chain.from_iterable(drawn.members[key])]
    shown = [one_line(one) if isinstance(one, str) else object_name(one[1], one[0]) for one in members[:_MOST_NAMES]]
    shown += [f"and {len(members) - len(shown)} more"] * (len(members) > len(shown))
    if not isinstance(key, str) and len(members) == 1:
        shown[-1] += f" ({KINDS[box.kind]})"
    pattern = not isinstance(key, str) and key[1] in labelled.patterns
    probe = not isinstance(key, str) and key[1] in labelled.probes
    shown[-1] += ", an expression of the policy" * pattern + ", a name made up to probe a pattern" * probe
    alike = len(drawn.members[key][0]) > 1
    return {
        "box": box,
        "classes": f"box {box.kind}" + " pattern" * pattern + " probe" * probe + " alike" * alike,
        "title": shown,
        "mark_title": [sentence(one, labelled.transports) for one in drawn.marks.get(key, ())],
        "numbers": _numbers(drawn.members[key], number),
    }


def _edge(line: EdgeLine, drawn: SimplifiedGraph, number: NodeNumber | None) -> dict[str, object]:
    """Return an edge with what a picture shows of it; the head of an arrow is a step to the tip, to the left if < 0."""
    one, transports = line.labelled, drawn.labelled.transports
    more = len(drawn.stands[one]) - 1
    outcome = one.outcome(drawn.options.transport)
    outward, inward = directions(one.edge.permission)
    head = math.copysign(_HEAD * (1.25 if outcome.false else 1.0), line.x2 - line.x1)
    start, end = line.x1 + (head if inward else 0.0), line.x2 - (head if outward else 0.0)
    return {
        "line": line,
        "outcome": outcome,
        "classes": edge_classes(outcome, labels=bool(transports)),
        "title": sentence(one, transports) + (f", and {more} more that it stands for" if more else ""),
        "subject": _numbers(drawn.members[one.edge.subject], number),
        "object": _numbers(drawn.members[one.edge.domain_object], number),
        "letter": SIGNS[role(one.edge.permission)],
        "start": start,
        "end": end,
        "bend": _BEND * (end - start),
        "heads": [(line.x2, line.y2, head)] * outward + [(line.x1, line.y1, -head)] * inward,
        "dot": (start + (end - start) * _DOT_ACROSS, line.y1 + (line.y2 - line.y1) * _DOT_DOWN),
    }


def _numbers(members: Members, number: NodeNumber | None) -> str | None:
    """Return the page's numbers of the members of a box."""
    return " ".join(str(number(key)) for key in chain.from_iterable(members)) if number else None


def _number(value: float) -> str:
    return f"{value:.1f}".removesuffix(".0")


# -- legend -----------------------------------------------------------------------------------------------------------


def legend(drawn: SimplifiedGraph, panels: Sequence[Panel]) -> Iterator[LegendEntry]:
    """Yield the entries of a legend: subjects and objects, then edges.

    Args:
        drawn: the part of a graph that is drawn.
        panels: its layout.
    """
    labelled, objects = drawn.labelled, {one.edge.object for one in drawn.stands}
    kinds = {box.kind for panel in panels for box in panel.boxes}
    yield ("subject", "subject", "box")
    yield from ((name, kind, "box") for kind, name in KINDS.items() if kind in kinds)
    if not objects.isdisjoint(labelled.patterns):
        yield ("expression", "pattern neutral", "box")
    if not objects.isdisjoint(labelled.probes):
        yield ("name made up to probe a pattern", "probe neutral", "box")
    roles = {role(one.edge.permission) for one in drawn.stands}
    spelled = {name: f"{SIGNS[name]} {name}" if drawn.matrices else name for name in SIGNS}
    for target, directed in (("object", OUTWARD), ("subject", INWARD)):
        named = [spelled[name] for name in directed if name in roles and name != "relay"]
        if named:
            yield (f"to the {target}: {', '.join(named)}", "plain", "arrow")
    if "relay" in roles:
        yield (f"both ways: {spelled['relay']}", "plain", "both")
    outcomes = {one.outcome(drawn.options.transport) for one in drawn.stands}
    labels = bool(labelled.transports)
    compared = {EdgeOutcome.ALLOW: " (true positive)", EdgeOutcome.DENY: " (true negative)"} if labels else {}
    for outcome in (EdgeOutcome.ALLOW, EdgeOutcome.DENY, EdgeOutcome.FALSE_POSITIVE, EdgeOutcome.FALSE_NEGATIVE):
        if outcome in outcomes:
            text = OUTCOMES[outcome] + compared.get(outcome, "")
            form = "sign" if drawn.matrices else "arrow" if outcome.allowed else "barred"
            yield (text, edge_classes(outcome, labels=labels), form)
    extra = {
        ("AUDIT rule", "audited", "dot"): any(one.audit for one in drawn.stands),
        ("what every node may do (--common draws it)", "muted", "+N"): bool(drawn.marks),
        ("alike: equal up to the name, one is drawn", "muted", "N"): bool(drawn.fold.classes),
    }
    yield from (entry for entry, wanted in extra.items() if wanted)
