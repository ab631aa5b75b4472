# SPDX-License-Identifier: Apache-2.0
"""Formats of pictures besides SVG: Graphviz' DOT language, for other layouts, and PNG.

PNG is converted from SVG with resvg, an optional dependency: a wheel without system libraries.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from comarmor.text import one_line
from keymint.api.graph import EdgeOutcome
from keymint.api.plugin_loader import how_to_add
from keymint.drawing.appearance import FONTS, LIGHT, directions, edge_classes, sentence
from keymint.drawing.captions import marks_of, names_of, subtitle
from keymint.drawing.labelled_graph import LabelledEdge, LabelledGraph
from keymint.drawing.layout import NodeKey
from keymint.drawing.simplify import DrawingOptions, SimplifiedGraph, simplify
from keymint.errors import KeymintError


def dot_simplified(labelled: LabelledGraph, options: DrawingOptions) -> SimplifiedGraph:
    """Return the part of a graph that is drawn: as lines, all of them unless the options have a limit."""
    return simplify(labelled, replace(options, group=False, limit=options.limit or max(1, labelled.total)))


def dot_document(drawn: SimplifiedGraph) -> bytes:
    """Return a DOT document in UTF-8 with what :func:`dot_simplified` returns."""
    labelled, options, edges = drawn.labelled, drawn.options, drawn.stands
    names, marks = names_of(drawn), marks_of(drawn)
    named = labelled.patterns | labelled.probes
    caption = "\n".join((labelled.title, subtitle(drawn).replace("; ", "\n"), *labelled.made))
    title = r"\n".join(map(_escaped, caption.split("\n")))
    nodes: dict[NodeKey, str] = {subject: f"s{at}" for at, subject in enumerate(drawn.fold.subjects)}
    nodes |= {key: f"o{at}" for at, key in enumerate(sorted({one.edge.domain_object for one in edges}))}

    def node(key: NodeKey) -> str:
        kind = "subject" if isinstance(key, str) else key[1].kind
        label = _escaped(names[key] + (f" ({marks[key]})" if key in marks else ""))
        shape = "ellipse" if kind == "subject" else "box"
        style = ', style="filled,dashed"' if not isinstance(key, str) and key[1] in named else ""
        return f'label="{label}", shape={shape}, fillcolor="{LIGHT[f"{kind}-fill"]}", color="{LIGHT[kind]}"{style}'

    lines = [
        "digraph keymint {",
        f'  graph [rankdir=LR, label="{title}", labelloc=t, fontname=monospace]',
        "  node [style=filled, fontname=monospace]",
        *(f"  {at} [{node(key)}]" for key, at in nodes.items()),
        *(
            f"  {nodes[one.edge.subject]} -> {nodes[one.edge.domain_object]} [{_attributes(one, labelled, options)}]"
            for one in edges
        ),
        "}",
    ]
    return ("\n".join(lines) + "\n").encode()


def _escaped(text: str) -> str:
    r"""Return the inside of a quoted string of DOT; an unescaped ``\`` starts an escape in a label."""
    return one_line(text).replace("\\", "\\\\").replace('"', '\\"')


def _attributes(one: LabelledEdge, labelled: LabelledGraph, options: DrawingOptions) -> str:
    outcome = one.outcome(options.transport)
    out, into = directions(one.edge.permission)
    verdict = edge_classes(outcome, labels=False).partition(" ")[0]
    attributes: Mapping[str, str] = {
        "dir": "both" if out and into else "forward" if out else "back",
        "color": LIGHT[verdict],
        "style": "solid" if outcome.false or not labelled.transports else "dashed",
        "penwidth": "4" if outcome is EdgeOutcome.FALSE_POSITIVE else "3" if outcome.false else "1",
        "arrowhead": "normal" if verdict != "deny" else "teeempty",
        "arrowtail": "normal" if verdict != "deny" else "teeempty",
        "label": " ".join(["DANGER"] * (outcome is EdgeOutcome.FALSE_POSITIVE) + ["AUDIT"] * one.audit),
        "tooltip": sentence(one, labelled.transports),
    }
    return ", ".join(f'{name}="{_escaped(value)}"' for name, value in attributes.items() if value)


MOST_PIXELS = 100_000_000
"""Maximum pixels of a picture: 400 MB while it is drawn."""
_NOTHING = '<svg xmlns="http://www.w3.org/2000/svg" width="20" height="20"></svg>'
_LETTER = _NOTHING.replace("></", f'><text x="2" y="16" font-family="{FONTS}">x</text></')


def png(document: bytes, scale: float = 2.0) -> bytes:
    """Return a picture as PNG.

    Args:
        document: an SVG document in UTF-8 by :func:`keymint.drawing.svg.svg`.
        scale: pixels of the picture per pixel of the document; less if it would have more than 100 million.

    Raises:
        KeymintError: resvg is not installed, finds no font, or cannot draw the picture.
    """
    try:
        import resvg_py  # noqa: PLC0415 - optional
    except ImportError as error:
        message = "PNG pictures need resvg, which is not installed"
        help_ = f"install it with '{how_to_add('resvg-py')}', or write .svg"
        raise KeymintError(message, help=help_, code="png-unavailable") from error
    from lxml import etree  # noqa: PLC0415 - slow, only for PNG

    root = etree.fromstring(document)
    pixels = float(root.get("width", "1")) * float(root.get("height", "1"))
    zoom = min(scale, (MOST_PIXELS / pixels) ** 0.5)
    try:
        if resvg_py.svg_to_bytes(svg_string=_LETTER) == resvg_py.svg_to_bytes(svg_string=_NOTHING):
            message = "no fixed-width font is installed; the picture would have no names"
            help_ = "install one (fonts-dejavu-core on Debian and Ubuntu), or write .svg"
            raise KeymintError(message, help=help_, code="png-fonts")
        return bytes(resvg_py.svg_to_bytes(svg_string=document.decode(), zoom=zoom))
    except ValueError as error:
        raise KeymintError(
            f"the picture cannot be drawn as PNG: {error}", help="write .svg", code="png-failed"
        ) from error
