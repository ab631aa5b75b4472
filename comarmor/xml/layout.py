# SPDX-License-Identifier: Apache-2.0
"""Lay out an XML document: indentation, quotes, line breaks and the order of attributes, and nothing else.

Comments and processing instructions (XML 1.0, 2.5 and 2.6) are kept in their places, and so are prefixes of namespaces.
White space between elements means nothing in the formats that are laid out here; their schemas forbid text there.
"""

from __future__ import annotations

import unicodedata
from codecs import BOM_UTF8, BOM_UTF16_BE, BOM_UTF16_LE
from collections.abc import Callable, Iterator, Sequence
from dataclasses import field
from xml.parsers import expat  # nosec - only documents that comarmor.xml.reader accepts, which refuses every DOCTYPE

from comarmor.values import dataclass

_INDENT = 2
_REFERENCES = {"&": "&amp;", "<": "&lt;", ">": "&gt;"}
_BYTE_ORDER_MARKS = (BOM_UTF8, BOM_UTF16_LE, BOM_UTF16_BE)
_UNSEEN = frozenset(("Cc", "Cf", "Zl", "Zp", "Zs"))
"""General categories of characters that a reader of the document does not see, or cannot tell from a space."""


@dataclass(frozen=True, slots=True)
class DocumentLayout:
    """The layout of a format.

    Attributes:
        text: names of the elements that contain text; all others contain elements only.
        inline: names of the elements that are written on one line, with the elements in them.
        order: names of attributes in their order; others follow by the alphabet; namespaces come first.
        trimmed: returns the text of an element without the white space around it, as readers of the format ignore it.
        width: columns; each attribute of a longer start tag is written on a line of its own.
    """

    text: frozenset[str]
    inline: frozenset[str]
    order: Sequence[str]
    trimmed: Callable[[str], str]
    width: int = 120


@dataclass(frozen=True, slots=True)
class Markup:
    """A comment or a processing instruction.

    Attributes:
        source: as it is written, with its delimiters.
        gap: line breaks between what precedes it and itself.
        column: column of its first character, from 0.
    """

    source: str
    gap: int
    column: int


@dataclass(slots=True)
class Element:
    """An element.

    Attributes:
        name: with its prefix.
        attributes: names with their prefixes, and values; declarations of namespaces as well.
        gap: line breaks between what precedes it and itself.
        children: what it contains; text only if the layout says so.
        end_gap: line breaks between the last of its children and its end tag.
    """

    name: str
    attributes: dict[str, str]
    gap: int
    children: list[Element | Markup | str] = field(default_factory=list)
    end_gap: int = 0


def nodes(content: bytes, layout: DocumentLayout) -> Element:
    """Return what a document contains, in an element without a name.

    Args:
        content: a document that :func:`comarmor.xml.reader.parse` accepts.
        layout: its layout.
    """
    builder = _Builder(layout, has_mark=content.startswith(_BYTE_ORDER_MARKS))
    builder.parser.Parse(content, True)
    return builder.open[0]


def markup(element: Element) -> Iterator[Markup]:
    """Yield the comments and processing instructions in an element, in the order of the document."""
    for child in element.children:
        if isinstance(child, Markup):
            yield child
        elif isinstance(child, Element):
            yield from markup(child)


def laid_out(document: Element, layout: DocumentLayout) -> str:
    """Return a document in its layout, without an XML declaration; each line ends with a line feed.

    Args:
        document: from :func:`nodes`.
        layout: its layout.
    """
    printer = _Printer(layout)
    for child in document.children:
        printer.child(child, 0, is_first=not printer.lines)
    return "\n".join([*printer.lines, ""])


class _Builder:
    """Builds the nodes of a document.

    Args:
        layout: its layout.
        has_mark: it begins with a byte order mark.
    """

    def __init__(self, layout: DocumentLayout, *, has_mark: bool) -> None:
        self.layout = layout
        self.has_mark = has_mark
        self.open = [Element("", {}, 0)]
        self.between: list[str] = []
        """The text since the last tag, comment or processing instruction."""
        self.parser = expat.ParserCreate()
        self.parser.buffer_text = True
        self.parser.StartElementHandler = self.start
        self.parser.EndElementHandler = self.end
        self.parser.CharacterDataHandler = self.between.append
        self.parser.CommentHandler = lambda text: self.markup(f"<!--{text}-->")
        self.parser.ProcessingInstructionHandler = lambda target, data: self.markup(
            f"<?{target} {data}?>" if data else f"<?{target}?>"
        )
        self.parser.DefaultHandler = self.outside

    def outside(self, text: str) -> None:
        """Take what stands before or after the root element (expat's handler of everything else)."""
        if len(self.open) == 1 and text.isspace():
            self.between.append(text.replace("\r\n", "\n").replace("\r", "\n"))

    def gap(self) -> int:
        """Return the line breaks since the last node; text is a node where the layout has text."""
        text = "".join(self.between)
        self.between.clear()
        if self.open[-1].name not in self.layout.text:
            return text.count("\n")
        if text:
            self.open[-1].children.append(text)
        return 0

    def start(self, name: str, attributes: dict[str, str]) -> None:
        element = Element(name, attributes, self.gap())
        self.open[-1].children.append(element)
        self.open.append(element)

    def end(self, _name: str) -> None:
        self.open[-1].end_gap = self.gap()
        self.open.pop()

    def markup(self, source: str) -> None:
        is_after_mark = self.has_mark and self.parser.CurrentLineNumber == 1  # expat counts it as a column
        self.open[-1].children.append(Markup(source, self.gap(), self.parser.CurrentColumnNumber - is_after_mark))


class _Printer:
    """Writes nodes as lines.

    Args:
        layout: their layout.
    """

    def __init__(self, layout: DocumentLayout) -> None:
        self.layout = layout
        self.lines: list[str] = []

    def child(self, child: Element | Markup | str, indent: int, *, is_first: bool) -> None:
        """Write a node on a line of its own; a comment stays on the line of what precedes it.

        Args:
            child: the node.
            indent: its column.
            is_first: a blank line before it is dropped.
        """
        if isinstance(child, str):
            return
        if isinstance(child, Markup) and child.gap == 0 and self.lines:
            before = self.lines.pop()
            self.lines.append(f"{before} {_moved(child, len(before) - before.rfind(chr(10)))}")
            return
        if child.gap > 1 and not is_first:
            self.lines.append("")
        if isinstance(child, Markup):
            self.lines.append(" " * indent + _moved(child, indent))
        else:
            self.element(child, indent)

    def element(self, element: Element, indent: int) -> None:
        start, end = self.start_tag(element, indent), f"</{element.name}>"
        margin = " " * indent
        if (content := self.one_line(element)) is not None:
            self.lines.append(f"{margin}<{start}>{content}{end}" if content else f"{margin}<{start}/>")
            return
        self.lines.append(f"{margin}<{start}>")
        is_root = not indent
        for at, child in enumerate(element.children):
            self.child(child, indent + _INDENT, is_first=not at and not is_root)
        if is_root and element.end_gap > 1:
            self.lines.append("")
        self.lines.append(f"{margin}{end}")

    def one_line(self, element: Element) -> str | None:
        """Return the content of an element that is written on one line; None for any other."""
        if element.name in self.layout.text:
            return self.text(element)
        if not element.children:
            return ""
        if element.name not in self.layout.inline or any(markup(element)):
            return None
        return "".join(
            f"<{self.start_tag(child, 0)}>{inner}</{child.name}>" if inner else f"<{self.start_tag(child, 0)}/>"
            for child in element.children
            if isinstance(child, Element)
            for inner in [self.one_line(child)]
        )

    def text(self, element: Element) -> str:
        """Return the content of an element with text; comments in it stay where they are."""
        whole = "".join(child for child in element.children if isinstance(child, str))
        trimmed = self.layout.trimmed(whole)
        begin = whole.index(trimmed)
        at, parts = 0, []
        for child in element.children:
            if isinstance(child, str):
                parts.append(_escaped(child[max(0, begin - at) : max(0, begin + len(trimmed) - at)]))
                at += len(child)
            elif isinstance(child, Markup):
                parts.append(child.source)
        return "".join(parts)

    def start_tag(self, element: Element, indent: int) -> str:
        """Return a start tag without its delimiters."""
        attributes = [
            f'{name}="{attribute_value(value)}"' for name, value in sorted(element.attributes.items(), key=self.rank)
        ]
        tag = " ".join((element.name, *attributes))
        if indent + len(f"<{tag}/>") <= self.layout.width:
            return tag
        return f"{element.name} " + f"\n{' ' * (indent + len(element.name) + 2)}".join(attributes)

    def rank(self, attribute: tuple[str, str]) -> tuple[bool, int, str]:
        name, order = attribute[0], self.layout.order
        is_namespace = name == "xmlns" or name.startswith("xmlns:")
        return not is_namespace, order.index(name) if name in order else len(order), name


def _moved(node: Markup, column: int) -> str:
    """Return a comment whose further lines move by as many columns as its first one; an instruction as it is."""
    if "\n" not in node.source or node.source.startswith("<?"):
        return node.source
    first, *others = node.source.split("\n")
    return "\n".join([first, *[_shifted(line, column - node.column) for line in others]])


def _shifted(line: str, by: int) -> str:
    """Return a line with another indentation, of spaces; a tab counts as one, as it does in columns."""
    text = line.lstrip(" \t")
    return " " * max(0, len(line) - len(text) + by) + text if text else ""


def _escaped(text: str) -> str:
    """Return character data (XML 1.0, 2.4); characters that nobody sees become references."""
    if text.isascii() and text.isprintable() and not any(each in text for each in _REFERENCES):
        return text
    return "".join(_REFERENCES.get(each) or _seen(each) for each in text)


def attribute_value(value: str) -> str:
    """Return the value of an attribute as it stands between double quotes (XML 1.0, 2.3)."""
    return _escaped(value).replace('"', "&quot;")


def _seen(character: str) -> str:
    is_unseen = character != " " and unicodedata.category(character) in _UNSEEN
    return f"&#x{ord(character):X};" if is_unseen else character
