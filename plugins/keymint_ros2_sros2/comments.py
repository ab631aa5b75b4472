# SPDX-License-Identifier: Apache-2.0
"""Find the comments of a document, which the reader of XML removes: each belongs to the element that follows it."""

from __future__ import annotations

from collections.abc import Mapping
from xml.parsers import expat  # nosec - the document was read with limits and without a DOCTYPE before

from lxml import etree

from comarmor.values import dataclass


@dataclass(frozen=True, slots=True, eq=False)
class Comments:
    """The comments of a document.

    Attributes:
        before: those between an element and the one before it in its parent, or the parent's start.
        closing: those after the last child of an element.
    """

    before: Mapping[etree._Element, tuple[str, ...]]
    closing: Mapping[etree._Element, tuple[str, ...]]


def comments_of(content: bytes, root: etree._Element) -> Comments:
    """Return the comments of a document.

    Args:
        content: the document.
        root: its root element, from :func:`comarmor.xml.reader.parse`.
    """
    before: dict[etree._Element, tuple[str, ...]] = {}
    closing: dict[etree._Element, tuple[str, ...]] = {}
    around: list[etree._Element] = []
    pending: list[str] = []
    elements = root.iter()

    def start(_tag: str, _attributes: Mapping[str, str]) -> None:
        around.append(next(elements))
        assign(before)

    def end(_tag: str) -> None:
        assign(closing)
        around.pop()

    def assign(to: dict[etree._Element, tuple[str, ...]]) -> None:
        if pending:
            to[around[-1]] = tuple(pending)
            pending.clear()

    parser = expat.ParserCreate()
    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.CommentHandler = pending.append
    parser.Parse(content, True)
    closing[root] = (*closing.get(root, ()), *pending)
    return Comments(before, closing)
