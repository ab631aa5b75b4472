# SPDX-License-Identifier: Apache-2.0
"""Formats of pictures besides SVG: Graphviz' DOT language, for other layouts, and PNG.

PNG is converted from SVG with resvg, an optional dependency: a wheel without system libraries.
"""

from __future__ import annotations

from comarmor.values import replace
from keymint.api.plugin_loader import how_to_add
from keymint.drawing.appearance import FONTS, LIGHT, directions, edge_classes, sentence
from keymint.drawing.captions import marks_of, names_of, subtitle
from keymint.drawing.labelled_graph import LabelledGraph
from keymint.drawing.layout import NodeKey
from keymint.drawing.simplify import DrawingOptions, SimplifiedGraph, simplify
from keymint.drawing.svg import from_template
from keymint.errors import KeymintError


def dot_simplified(labelled: LabelledGraph, options: DrawingOptions) -> SimplifiedGraph:
    """Return the part of a graph that is drawn: as lines, all of them unless the options have a limit."""
    return simplify(labelled, replace(options, group=False, limit=options.limit or max(1, labelled.total)))


def dot_document(drawn: SimplifiedGraph) -> bytes:
    """Return a DOT document in UTF-8 with what :func:`dot_simplified` returns."""
    labelled = drawn.labelled
    caption = "\n".join((labelled.title, subtitle(drawn).replace("; ", "\n"), *labelled.made))
    nodes: dict[NodeKey, str] = {subject: f"s{at}" for at, subject in enumerate(drawn.fold.subjects)}
    nodes |= {key: f"o{at}" for at, key in enumerate(sorted({one.edge.domain_object for one in drawn.stands}))}
    return from_template(
        "picture.dot.j2",
        drawn=drawn,
        transports=labelled.transports,
        caption=caption.split("\n"),
        nodes=nodes,
        names=names_of(drawn),
        marks=marks_of(drawn),
        unreal=labelled.patterns | labelled.probes,
        light=LIGHT,
        directions=directions,
        edge_classes=edge_classes,
        sentence=sentence,
    ).encode()


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
