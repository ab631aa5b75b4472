# SPDX-License-Identifier: Apache-2.0
"""Find the comments of a document, which the reader of XML removes: each belongs to the element that follows it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from xml.parsers import expat  # nosec - the document was read with limits and without a DOCTYPE before

from lxml import etree

from comarmor.values import dataclass


@dataclass(frozen=True, slots=True, eq=False)
class Comments:
    """The comments of a document.

    Attributes:
        leading: the comments before an element, by the element's number in document order.
        trailing: the comments after the last child of an element, by its number.
        numbers: the numbers of the elements.
    """

    leading: Mapping[int, tuple[str, ...]]
    trailing: Mapping[int, tuple[str, ...]]
    numbers: Mapping[etree._Element, int]

    def before(self, element: etree._Element) -> tuple[str, ...]:
        """Return the comments between an element and the one before it in its parent, or the parent's start."""
        return self.leading.get(self.numbers[element], ())

    def closing(self, element: etree._Element) -> tuple[str, ...]:
        """Return the comments after the last child of an element."""
        return self.trailing.get(self.numbers[element], ())


@dataclass(slots=True)
class _Scanner:
    """Collects comments; its methods are handlers of expat."""

    count: int = 0
    open: list[int] = field(default_factory=list)
    pending: list[str] = field(default_factory=list)
    leading: dict[int, tuple[str, ...]] = field(default_factory=dict)
    trailing: dict[int, tuple[str, ...]] = field(default_factory=dict)

    def start(self, _tag: str, _attributes: Mapping[str, str]) -> None:
        if self.pending:
            self.leading[self.count] = tuple(self.pending)
            self.pending.clear()
        self.open.append(self.count)
        self.count += 1

    def end(self, _tag: str) -> None:
        number = self.open.pop()
        if self.pending:
            self.trailing[number] = tuple(self.pending)
            self.pending.clear()

    def comment(self, text: str) -> None:
        self.pending.append(text)


def comments_of(content: bytes, root: etree._Element) -> Comments:
    """Return the comments of a document.

    Args:
        content: the document.
        root: its root element, from :func:`comarmor.xml.reader.parse`.
    """
    scanner = _Scanner()
    parser = expat.ParserCreate()
    parser.StartElementHandler = scanner.start
    parser.EndElementHandler = scanner.end
    parser.CommentHandler = scanner.comment
    parser.Parse(content, True)
    scanner.trailing[0] = (*scanner.trailing.get(0, ()), *scanner.pending)
    return Comments(scanner.leading, scanner.trailing, {element: number for number, element in enumerate(root.iter())})
