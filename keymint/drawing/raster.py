# SPDX-License-Identifier: Apache-2.0
"""Convert SVG to PNG with resvg, an optional dependency: a wheel without system libraries."""

from __future__ import annotations

from lxml import etree

from keymint.api.plugin_loader import how_to_add
from keymint.drawing.appearance import FONTS
from keymint.errors import KeymintError

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
        raise KeymintError(
            "PNG pictures need resvg, which is not installed",
            help=f"install it with '{how_to_add('resvg-py')}', or write .svg",
            code="png-unavailable",
        ) from error
    root = etree.fromstring(document)
    pixels = float(root.get("width", "1")) * float(root.get("height", "1"))
    zoom = min(scale, (MOST_PIXELS / pixels) ** 0.5)
    try:
        if resvg_py.svg_to_bytes(svg_string=_LETTER) == resvg_py.svg_to_bytes(svg_string=_NOTHING):
            raise KeymintError(
                "no fixed-width font is installed; the picture would have no names",
                help="install one (fonts-dejavu-core on Debian and Ubuntu), or write .svg",
                code="png-fonts",
            )
        return bytes(resvg_py.svg_to_bytes(svg_string=document.decode(), zoom=zoom))
    except ValueError as error:
        raise KeymintError(
            f"the picture cannot be drawn as PNG: {error}", help="write .svg", code="png-failed"
        ) from error
