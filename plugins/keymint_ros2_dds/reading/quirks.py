# SPDX-License-Identifier: Apache-2.0
"""Find what makes vendors read a signed document differently from a plain one.

The models of vendors hold for plain documents: what the schema allows, as elements and text. Comments between elements,
white space, the order of attributes and the XML declaration make no difference. For other quirks this states what each
vendor was measured to do. What was not measured for all such documents is :attr:`VendorReading.UNMODELLED`: then
nothing is claimed of that vendor.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from enum import Enum
from operator import attrgetter

from lxml import etree

from comarmor.data import locate
from comarmor.errors import ComArmorError, Diagnostic
from comarmor.regex import lazy_regex
from comarmor.values import dataclass
from comarmor.xml import schema
from comarmor.xml.reader import line
from keymint_ros2_dds.domains import MAX_DOMAIN

BLANKS = " \t\v\r\n"
"""White space of XML, as Cyclone DDS trims it."""


class VendorReading(Enum):
    """What a vendor does with a document that has a quirk.

    ``PLAIN``: it reads the document as if it had none. ``REFUSES``: it refuses the document. ``CRASHES``: its process
    ends. ``UNMODELLED``: not known.
    """

    PLAIN = "plain"
    REFUSES = "refuses"
    CRASHES = "crashes"
    UNMODELLED = "unmodelled"


PLAIN, REFUSES, CRASHES, UNMODELLED = VendorReading


@dataclass(frozen=True, slots=True)
class Quirk:
    """A property of a document that a plain one does not have.

    Attributes:
        line: its line in the document.
        text: what it is, as the end of "Cyclone DDS refuses …".
        cyclone: what Cyclone DDS 0.10.2 does.
        fast: what Fast DDS 2.9.1 does.
    """

    line: int
    text: str
    cyclone: VendorReading
    fast: VendorReading


_BOM = b"\xef\xbb\xbf"
_DECLARATION = lazy_regex(rb"<\?xml\s[^?]*\?>")
_ENCODING = lazy_regex(rb"\sencoding\s*=\s*[\"']([^\"']*)")
_UTF_8 = lazy_regex(rb"utf-8|us-ascii", re.IGNORECASE)
_LIKE_ASCII = lazy_regex(rb"iso-8859-\d+|windows-125\d", re.IGNORECASE)
"""Encodings in which ASCII characters have their ASCII bytes; parsers of vendors ignore the declaration."""
_COMMENTS = lazy_regex(rb"(\A|<[^<>!?][^<>]*>)(\s*(?:<!--(?:[^-]|-[^-])*-->\s*)+)(?=<|\Z)")
"""Comments between two tags."""
_ATTRIBUTES = lazy_regex(rb"\s(?:xmlns:xsi|xsi:noNamespaceSchemaLocation)\s*=\s*(?:\"[^\"<&]*\"|'[^'<&]*')")
"""Attributes that every vendor ignores."""
_MARKUP = (
    (lazy_regex(rb"<[!?]"), "a comment in a text, a CDATA section or a processing instruction", UNMODELLED, UNMODELLED),
    (lazy_regex(rb"&(?!(?:lt|gt|amp|apos|quot);)"), "a character reference", UNMODELLED, UNMODELLED),
    (lazy_regex(rb"\0"), "text of two bytes a character", UNMODELLED, UNMODELLED),
    (lazy_regex(rb"(?:xmlns|xsi:)[^<>=]*="), "an attribute about namespaces", UNMODELLED, PLAIN),
    (lazy_regex(rb"</[^<>\s]*\s"), "white space in an end tag", REFUSES, PLAIN),
)
_PLAIN_NUMBER = lazy_regex(r"0|[1-9][0-9]{0,8}")


def of_bytes(content: bytes, *, comments_until: int | None = None) -> Iterator[Quirk]:
    """Yield the quirks of the bytes of a document: its encoding, comments, references, and attributes.

    Args:
        content: the document; it is well-formed XML without a DOCTYPE.
        comments_until: offset up to which comments are ignored; None: everywhere.
    """
    if content.startswith(_BOM):
        yield Quirk(1, "a byte order mark", REFUSES, PLAIN)
    rest = content.removeprefix(_BOM)
    end = len(content) if comments_until is None else comments_until
    declaration = _DECLARATION.match(rest)
    if declaration is not None:
        encoding = _ENCODING.search(declaration[0])
        known = encoding is None or _UTF_8.fullmatch(encoding[1])
        if encoding is not None and not (known or (content.isascii() and _LIKE_ASCII.fullmatch(encoding[1]))):
            yield Quirk(1, f"text in the encoding {encoding[1].decode('latin-1')}", UNMODELLED, UNMODELLED)
        rest = _line_ends(declaration[0]) + rest[declaration.end() :]
    end = max(end - len(content) + len(rest), 0)
    rest = _COMMENTS.sub(lambda match: match[1] + _line_ends(match[2]), rest[:end]) + rest[end:]
    rest = _ATTRIBUTES.sub(lambda match: _line_ends(match[0]), rest)
    for expression, text, cyclone, fast in _MARKUP:
        match = expression.search(rest)
        if match is not None:
            yield Quirk(rest.count(b"\n", 0, match.start()) + 1, text, cyclone, fast)
            if cyclone is fast is UNMODELLED:
                return  # what follows may be part of a comment


def _line_ends(text: bytes) -> bytes:
    return b"\n" * text.count(b"\n")


def of_schema(
    root: etree._Element, kind: str, file: str, own: Iterable[Quirk] = ()
) -> tuple[tuple[Diagnostic, ...], tuple[Quirk, ...]]:
    """Return how a document violates its schema, with that as its quirk; if it does not, its own quirks by line.

    Args:
        root: its root element.
        kind: ``permissions`` or ``governance``.
        file: the document's file, for the defects.
        own: the quirks of a valid document.
    """
    try:
        schema.validate(root, locate("keymint_ros2_dds", "schemas") / f"{kind}.xsd", file)
    except ComArmorError as error:
        first = error.diagnostics[0]
        at = first.where.line if first.where and first.where.line else 1
        text = f"what the schema does not allow ({first.message})"
        return error.diagnostics, (Quirk(at, text, UNMODELLED, UNMODELLED),)
    return (), tuple(sorted(own, key=attrgetter("line")))


def of_domain_ids(root: etree._Element) -> Iterator[Quirk]:
    """Yield the quirks of the domain ids of a document that its schema allows."""
    for element in root.iter("id", "min", "max"):
        number = (element.text or "").strip(BLANKS)
        if _PLAIN_NUMBER.fullmatch(number) is None:
            yield Quirk(line(element), f"the domain id {number!r}", UNMODELLED, UNMODELLED)
        elif int(number) > MAX_DOMAIN:
            yield Quirk(line(element), f"a domain id above {MAX_DOMAIN}", REFUSES, PLAIN)
