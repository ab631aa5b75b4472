# SPDX-License-Identifier: Apache-2.0
"""Pictures as PNG, and as DOT for Graphviz."""

from __future__ import annotations

import re
import struct
import sys

import pytest

from keymint.api.plugin_loader import how_to_add
from keymint.drawing import other_formats
from keymint.drawing.other_formats import png
from keymint.drawing.simplify import DrawingOptions
from keymint.drawing.svg import svg
from keymint.errors import KeymintError

from .graphs import dot, hostile, one_of_each


def size(picture: bytes) -> tuple[int, int]:
    """Return width and height of a PNG (ISO/IEC 15948, 11.2.2)."""
    assert picture.startswith(b"\x89PNG\r\n\x1a\n")
    return struct.unpack(">II", picture[16:24])


def test_png_has_the_size_that_was_asked_for() -> None:
    document = svg(one_of_each())
    width, height = (float(value) for value in re.findall(rb' (?:width|height)="([\d.]+)"', document)[:2])
    for scale in (1, 2):
        assert size(png(document, scale)) == pytest.approx((width * scale, height * scale), abs=1)


def test_a_large_picture_is_made_smaller(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(other_formats, "MOST_PIXELS", 10_000)
    width, height = size(png(svg(one_of_each()), 10))
    assert width * height < 11_000


def test_names_are_drawn() -> None:
    document = svg(one_of_each())
    assert png(document, 1) != png(document.replace(b">/chatter</text>", b"></text>"), 1)


def test_without_resvg(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "resvg_py", None)
    with pytest.raises(KeymintError) as caught:
        png(svg(one_of_each()))
    assert f"install it with '{how_to_add('resvg-py')}', or write .svg" in str(caught.value)


def test_without_fonts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("resvg_py.svg_to_bytes", lambda **_: b"a picture without text")
    with pytest.raises(KeymintError, match="no fixed-width font"):
        png(svg(one_of_each()))


def test_dot() -> None:
    text = dot(one_of_each()).decode()
    assert text.startswith("digraph keymint {")
    edges = re.findall(r'(s\d) -> (o\d) \[dir="(\w+)", color="(#\w+)", style="(\w+)"', text)
    assert [(way, style) for _, _, way, _, style in edges] == [
        ("back", "solid"),
        ("back", "solid"),
        ("forward", "dashed"),
        ("back", "dashed"),
    ]


def test_dot_quotes_names() -> None:
    for line in dot(hostile(), DrawingOptions()).decode().splitlines():
        assert len(re.findall(r'(?<!\\)"', line.replace("\\\\", ""))) % 2 == 0, line
