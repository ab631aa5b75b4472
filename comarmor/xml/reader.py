# SPDX-License-Identifier: Apache-2.0
"""Read one XML document from bytes, with limits, without DOCTYPE, entities or network, and with exact line numbers.

The document is parsed twice: expat first checks the limits without building a tree, then lxml builds the tree. So a
document that exceeds a limit never becomes a tree.
"""

from __future__ import annotations

import pyexpat as expat  # xml.parsers.expat without the packages around it; every DOCTYPE is refused
from array import array
from typing import Any, NoReturn

from lxml import etree

from comarmor.errors import ComArmorError, Origin
from comarmor.text import quote
from comarmor.values import Data

XINCLUDE = "http://www.w3.org/2001/XInclude"
XSI = "http://www.w3.org/2001/XMLSchema-instance"
_COLUMN = 1 << 32
"""A place is a line times this, and a column."""
_CHUNK = 1 << 16
"""Bytes that are parsed at once."""
_HINTS = ("schemaLocation", "noNamespaceSchemaLocation")


class Limits(Data):
    """Limits of a document or policy; exceeding one is an error.

    Attributes:
        file_bytes: bytes of one file.
        total_bytes: bytes of all files.
        depth: nesting depth of elements in one file.
        tag_bytes: bytes of a tag or comment.
        parts: elements and texts of one file, and its attributes, each of which takes twice the memory.
        nodes: elements of one file, and of all files with each inclusion counted that reads or copies them.
        include_depth: nesting depth of includes.
        inclusions: such inclusions, nested ones counted each time.
        renamed: names of packages' files that symbolic links add.
    """

    file_bytes: int = 16 * 2**20
    total_bytes: int = 64 * 2**20
    depth: int = 64
    tag_bytes: int = 2**20
    parts: int = 1_100_000
    nodes: int = 1_000_000
    include_depth: int = 16
    inclusions: int = 50_000
    renamed: int = 500


LIMITS = Limits()


class _Element(etree.ElementBase):
    """An element with its exact place; libxml2 stores only 16 bits of the line, and of the start tag's end.

    Attributes:
        at: line and column in one number, see :data:`_COLUMN`.
        places: of the root: those of all elements in document order.
        elements: of the root: all others, once a place is asked for; lxml drops elements that nothing refers to.
    """

    __slots__ = ("at", "elements", "places")
    at: int
    places: array[int]
    elements: list[_Element]

    @property
    def sourceline(self) -> int:  # type: ignore[override]
        """Line number from 1, as expat counted it."""
        return self.place[0]

    @property
    def place(self) -> tuple[int, int]:
        """Line and column from 1, as expat counted them."""
        # Of a document that is refused for its root, no other place is asked: then each would take memory for nothing.
        own = getattr(self, "at", 0) or next(iter(getattr(self, "places", ())), 0)
        if not own:  # then no other element of the document has its place yet
            root: Any = self.getroottree().getroot()
            elements: list[Any] = list(root.iter())
            for element, at in zip(elements, getattr(root, "places", ()), strict=False):
                element.at = at
            root.elements = elements[1:]  # without the root, since a cycle would stay
            own = getattr(self, "at", 0)
        return divmod(own, _COLUMN)


def parse(content: bytes, name: str, *, limits: Limits = LIMITS, chain: tuple[Origin, ...] = ()) -> etree._Element:
    """Return the root element of an XML document.

    Comments and processing instructions are removed, so that the text of an element is in one piece. Schema locations
    (``xsi:schemaLocation``, ``xsi:noNamespaceSchemaLocation``) are accepted at the root and removed as well, so that no
    validator follows them. ``sourceline`` of each element is its exact line.

    Args:
        content: the document.
        name: path of the file as the user would type it, for messages.
        limits: limits of files and includes.
        chain: the places that include the document, innermost first.

    Raises:
        ComArmorError: not well-formed, too large, or with a DOCTYPE; with ``file:line``.
    """
    file = Origin(name, 0, chain)
    if len(content) > limits.file_bytes:
        raise ComArmorError(
            f"the file has more than the {limits.file_bytes:,} bytes allowed", where=file, code="xml-limit"
        )
    places = _Scanner(file, limits).scan(content)
    parser = etree.XMLParser(
        resolve_entities=False, load_dtd=False, no_network=True, remove_comments=True, remove_pis=True
    )
    parser.set_element_class_lookup(etree.ElementDefaultClassLookup(element=_Element))
    try:
        root: Any = etree.fromstring(content, parser)
    except etree.XMLSyntaxError as error:
        from comarmor.xml.syntax_errors import encoding_error  # noqa: PLC0415 - only messages of errors need it

        where = Origin(name, error.lineno or 0, chain)
        unreadable = encoding_error(content, where, is_token=False)
        raise (
            unreadable or ComArmorError(f"not well-formed XML: {error.msg}", where=where, code="xml-syntax")
        ) from None
    docinfo: Any = root.getroottree().docinfo
    # One by one: count(//*) of XPath makes a list of all elements first, when a refused file takes the most memory.
    if docinfo.doctype or sum(1 for _ in root.iter("*")) != len(places):
        # The two parsers read different documents: the file is crafted so that tools read it differently.
        raise ComArmorError("the file is not plain XML", where=file, code="xml-syntax")
    root.places = places
    for hint in _HINTS:
        root.attrib.pop(f"{{{XSI}}}{hint}", "")
    checked: etree._Element = root
    return checked


def looks_like_xml(content: bytes) -> bool:
    """Tell whether a file begins as a document does, in UTF-8 or UTF-16, with a byte order mark or without."""
    return content.lstrip(b"\xef\xbb\xbf\xfe\xff\0 \t\r\n").startswith(b"<")


def line(element: etree._Element) -> int:
    """Return the line on which an element of a parsed document begins, from 1."""
    sourceline = element.sourceline
    return sourceline if isinstance(sourceline, int) else 0


def line_in(root: etree._Element, element: etree._Element) -> int:
    """Return the line of an element of a document that is not read any further: others get no place."""
    before: Any = element.xpath("count(preceding::*) + count(ancestor::*)")
    return root.places[int(before)] // _COLUMN if isinstance(root, _Element) else line(element)


def place(element: etree._Element) -> tuple[int, int]:
    """Return line and column at which an element of a parsed document begins, from 1."""
    return element.place if isinstance(element, _Element) else (0, 0)


class _Scanner:
    """Checks the limits of a document, and records the places of its elements, without building a tree.

    Args:
        file: the file as a place.
        limits: limits of files and includes.
    """

    def __init__(self, file: Origin, limits: Limits) -> None:
        self.file = file
        self.limits = limits
        self.places = array("Q")
        self.parts = 0
        self.open: list[tuple[str, int]] = []
        self.parser = expat.ParserCreate(namespace_separator="}")
        self.parser.StartElementHandler = self.start
        self.parser.EndElementHandler = lambda _tag: self.open.pop()
        self.parser.StartDoctypeDeclHandler = self.doctype

    def scan(self, content: bytes) -> array[int]:
        """Return line and column of each element in one number, in document order.

        Raises:
            ComArmorError: not well-formed, too large, or with a DOCTYPE.
        """
        try:
            self.parts = content.count(b">") - content.count(b"><")  # at most so many texts
            for at in range(0, len(content), _CHUNK):
                self.parser.Parse(content[at : at + _CHUNK], False)
                if at + _CHUNK - self.parser.CurrentByteIndex > self.limits.tag_bytes:
                    self.refuse(f"a tag or comment has more than {self.limits.tag_bytes:,} bytes", "xml-limit")
            self.parser.Parse(b"", True)
        except expat.ExpatError as error:
            from comarmor.xml.syntax_errors import syntax_error  # noqa: PLC0415 - only messages of errors need it

            at, begun = self.parser.ErrorByteIndex, bool(self.places)
            raise syntax_error(error, content, at, self.open, self.at(error.lineno), begun=begun) from None
        except (LookupError, UnicodeError, ValueError) as error:
            raise ComArmorError(
                f"the encoding of the file is not usable: {quote(str(error))}",
                where=self.at(1),
                help="save it as UTF-8",
                code="xml-encoding",
            ) from None
        del self.parser  # its handlers refer to this object: without the cycle, the places end with the tree
        return self.places

    def at(self, number: int) -> Origin:
        """Return the place of a line."""
        return Origin(self.file.file, number, self.file.chain)

    def refuse(self, message: str, code: str, help_: str = "") -> NoReturn:
        """Stop at the current line."""
        raise ComArmorError(message, where=self.at(self.parser.CurrentLineNumber), help=help_, code=code)

    def start(self, tag: str, attributes: dict[str, str]) -> None:
        """Record the place of an element (expat's handler of start tags)."""
        current = self.parser.CurrentLineNumber
        self.open.append((tag, current))
        self.places.append(current * _COLUMN + self.parser.CurrentColumnNumber + 1)
        if len(self.open) > self.limits.depth:
            self.refuse(f"elements are nested more than {self.limits.depth} deep", "xml-limit")
        if len(self.places) > self.limits.nodes:
            self.refuse(f"the file has more than the {self.limits.nodes:,} elements allowed", "xml-limit")
        self.parts += 1 + 2 * len(attributes)
        if self.parts > self.limits.parts:
            self.refuse(f"the file has more than {self.limits.parts:,} elements, attributes and texts", "xml-limit")
        for attribute in attributes:
            space, _, local = attribute.rpartition("}")
            if space == XSI and (len(self.places) > 1 or local not in _HINTS):
                self.refuse(f"the attribute xsi:{local} is not expected here", "schema", "remove it")

    def doctype(self, *_args: object) -> None:
        """Refuse a DOCTYPE before its content is read."""
        self.refuse("a DOCTYPE is not allowed", "xml-doctype", "remove it; entities are not needed in these files")
