# SPDX-License-Identifier: Apache-2.0
"""Lay out a file of the language: indentation, quotes, line breaks and the order of attributes, and nothing else.

Comments and processing instructions (XML 1.0, 2.5 and 2.6) are kept in their places, and so are prefixes of namespaces.
White space between elements means nothing; the schemas forbid text there.
"""

from __future__ import annotations

import unicodedata
from codecs import BOM_UTF8, BOM_UTF16_BE, BOM_UTF16_LE
from collections.abc import Iterator
from xml.parsers import expat  # nosec - only documents that comarmor.xml.reader accepts, which refuses every DOCTYPE

from comarmor.language.attachments import strip
from comarmor.values import Data, field

TEXT = frozenset(("attachment", "value", "partition"))
"""The elements that contain text; all others contain elements only."""
_ON_ONE_LINE = "permissions"
"""The elements that are written on one line, with the elements in them."""
_ORDER = ("name", "qualifier", "modifier", "href", "parse", "subject", "permission", "object", "partition")
"""Attributes in their order; others follow by the alphabet; namespaces come first."""
_WIDTH = 120
"""Columns; each attribute of a longer start tag is written on a line of its own."""
_INDENT = 2
_REFERENCES = {"&": "&amp;", "<": "&lt;", ">": "&gt;"}
_BYTE_ORDER_MARKS = (BOM_UTF8, BOM_UTF16_LE, BOM_UTF16_BE)
_UNSEEN = frozenset(("Cc", "Cf", "Zl", "Zp", "Zs"))
"""General categories of characters that a reader of the document does not see, or cannot tell from a space."""


class Markup(Data):
    """A comment or a processing instruction.

    Attributes:
        source: as it is written, with its delimiters.
        gap: line breaks between what precedes it and itself.
        column: column of its first character, from 0.
    """

    source: str
    gap: int
    column: int


class Element(Data, frozen=False):
    """An element.

    Attributes:
        name: with its prefix.
        attributes: names with their prefixes, and values; declarations of namespaces as well.
        gap: line breaks between what precedes it and itself.
        children: what it contains; text only in those that :data:`TEXT` names.
        end_gap: line breaks between the last of its children and its end tag.
    """

    name: str
    attributes: dict[str, str]
    gap: int
    children: list[Element | Markup | str] = field(default_factory=list)
    end_gap: int = 0


def nodes(content: bytes) -> Element:
    """Return what a document contains, in an element without a name.

    Args:
        content: a document that :func:`comarmor.xml.reader.parse` accepts.
    """
    builder = _Builder(has_mark=content.startswith(_BYTE_ORDER_MARKS))
    builder.parser.Parse(content, True)
    return builder.open[0]


def markup(element: Element) -> Iterator[Markup]:
    """Yield the comments and processing instructions in an element, in the order of the document."""
    for child in element.children:
        if isinstance(child, Markup):
            yield child
        elif isinstance(child, Element):
            yield from markup(child)


def laid_out(document: Element) -> str:
    """Return a document in its layout, without an XML declaration; each line ends with a line feed.

    Args:
        document: from :func:`nodes`.
    """
    lines: list[str] = []
    for child in document.children:
        _write(child, 0, lines, is_first=not lines)
    return "\n".join([*lines, ""])


class _Builder:
    """Builds the nodes of a document.

    Args:
        has_mark: it begins with a byte order mark.
    """

    def __init__(self, *, has_mark: bool) -> None:
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
        """Return the line breaks since the last node; text is a node in an element that contains text."""
        text = "".join(self.between)
        self.between.clear()
        if self.open[-1].name not in TEXT:
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


def _write(child: Element | Markup | str, indent: int, lines: list[str], *, is_first: bool) -> None:
    """Write a node on a line of its own; a comment stays on the line of what precedes it.

    Args:
        child: the node.
        indent: its column.
        lines: the lines before it, which get those of the node.
        is_first: a blank line before it is dropped.
    """
    if isinstance(child, str):
        return
    if isinstance(child, Markup) and child.gap == 0 and lines:
        before = lines.pop()
        lines.append(f"{before} {_moved(child, len(before) - before.rfind(chr(10)))}")
        return
    if child.gap > 1 and not is_first:
        lines.append("")
    if isinstance(child, Markup):
        lines.append(" " * indent + _moved(child, indent))
    else:
        _write_element(child, indent, lines)


def _write_element(element: Element, indent: int, lines: list[str]) -> None:
    start, end = _start_tag(element, indent), f"</{element.name}>"
    margin = " " * indent
    if (content := _one_line(element)) is not None:
        lines.append(f"{margin}<{start}>{content}{end}" if content else f"{margin}<{start}/>")
        return
    lines.append(f"{margin}<{start}>")
    is_root = not indent
    for at, child in enumerate(element.children):
        _write(child, indent + _INDENT, lines, is_first=not at and not is_root)
    if is_root and element.end_gap > 1:
        lines.append("")
    lines.append(f"{margin}{end}")


def _one_line(element: Element) -> str | None:
    """Return the content of an element that is written on one line; None for any other."""
    if element.name in TEXT:
        return _text(element)
    if not element.children:
        return ""
    if element.name != _ON_ONE_LINE or any(markup(element)):
        return None
    return "".join(
        f"<{_start_tag(child, 0)}>{inner}</{child.name}>" if inner else f"<{_start_tag(child, 0)}/>"
        for child in element.children
        if isinstance(child, Element)
        for inner in [_one_line(child)]
    )


def _text(element: Element) -> str:
    """Return the content of an element with text; comments in it stay where they are."""
    whole = "".join(child for child in element.children if isinstance(child, str))
    trimmed = strip(whole)
    begin = whole.index(trimmed)
    at, parts = 0, []
    for child in element.children:
        if isinstance(child, str):
            parts.append(_escaped(child[max(0, begin - at) : max(0, begin + len(trimmed) - at)]))
            at += len(child)
        elif isinstance(child, Markup):
            parts.append(child.source)
    return "".join(parts)


def _start_tag(element: Element, indent: int) -> str:
    """Return a start tag without its delimiters."""
    attributes = [f'{name}="{attribute_value(value)}"' for name, value in sorted(element.attributes.items(), key=_rank)]
    tag = " ".join((element.name, *attributes))
    if indent + len(f"<{tag}/>") <= _WIDTH:
        return tag
    return f"{element.name} " + f"\n{' ' * (indent + len(element.name) + 2)}".join(attributes)


def _rank(attribute: tuple[str, str]) -> tuple[bool, int, str]:
    name = attribute[0]
    is_namespace = name == "xmlns" or name.startswith("xmlns:")
    return not is_namespace, _ORDER.index(name) if name in _ORDER else len(_ORDER), name


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
