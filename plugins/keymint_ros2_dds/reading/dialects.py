# SPDX-License-Identifier: Apache-2.0
"""How implementations read documents: the expressions, the dates, and what makes them differ from a plain document.

Expressions are read in a dialect of ``fnmatch``. All dialects compare bytes, as the vendors do in the C locale: text is
encoded as UTF-8, and each byte is one character. No expression is an error: see
:data:`comarmor.patterns.tokens.Undefined`. The dates of a grant's validity are ``xs:dateTime``; one that is invalid is
read as None.

The models of vendors hold for plain documents: what the schema allows, as elements and text. Comments between elements,
white space, the order of attributes and the XML declaration make no difference. For other quirks this states what each
vendor was measured to do. What was not measured for all such documents is :data:`UNMODELLED`: then nothing is claimed
of that vendor.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from datetime import UTC, datetime, timedelta
from functools import lru_cache
from operator import attrgetter
from typing import Literal

from lxml import etree

from comarmor.patterns.glob import parse, regex
from comarmor.patterns.tokens import SPECIAL, Dialect
from comarmor.text import lazy_regex
from comarmor.values import Data, replace
from comarmor.xml import schema
from comarmor.xml.reader import LIMITS, XSI, line
from keymint.errors import Diagnostic, KeymintError
from keymint_ros2_dds.domains import MAX_DOMAIN

STANDARD = Dialect()
"""POSIX ``fnmatch`` with flags 0, as DDS Security 1.1 requires (9.4.1.3.2.3.2.1)."""
FAST_DDS = Dialect(escapes=False)
"""``fnmatch(…, FNM_NOESCAPE)`` of the C library."""
CYCLONE_DDS = Dialect(escapes=False, negators=("!",), classes=False, closing_bracket_is_member=True)
"""Cyclone DDS's own matcher, ``ac_fnmatch``."""


def in_bytes(text: str) -> str:
    """Return a text with one character for each byte of its UTF-8 form."""
    return text if text.isascii() else text.encode("utf-8", "surrogateescape").decode("latin-1")


def is_plain(pattern: str) -> bool:
    """Return whether a pattern matches only itself in every dialect."""
    return not SPECIAL.search(pattern)


@lru_cache(maxsize=65536)
def translate(pattern: str, dialect: Dialect) -> str:
    """Return a pattern (in bytes) as a regular expression; see :func:`comarmor.patterns.glob.regex`."""
    return regex(parse(pattern, dialect))


_DATE = lazy_regex(r"(-?\d{4,})-(\d\d)-(\d\d)T(\d\d):(\d\d):(\d\d)(?:\.\d+)?(?:Z|([+-])(\d\d):(\d\d))?", re.ASCII)
_LAST_OF_CYCLONE = datetime(2262, 4, 11, 23, 47, 16, tzinfo=UTC)
DOCUMENT_LIMITS = replace(LIMITS, nodes=500_000)
"""Limits of a signed document, whose reader asks for places, each of which takes as much memory as an element."""
BLANKS = " \t\v\r\n"
"""White space of XML, as Cyclone DDS trims it."""
_FIRST, _LAST = datetime.min.replace(tzinfo=UTC), datetime.max.replace(tzinfo=UTC)
_LAST_MINUTE, _LAST_YEAR = 59, 9999


@lru_cache(maxsize=64)
def standard_date(text: str) -> datetime | None:
    """Read a date as the standard says (DDS Security 1.1, 9.4.1.3.2.2): without a zone it is UTC.

    A year beyond the range of :class:`datetime` is the end of that range.
    """
    match = _DATE.fullmatch(text.strip(BLANKS))
    if match is None:
        return None
    if not 1 <= (year := int(match[1])) <= _LAST_YEAR:
        return _LAST if year > 0 else _FIRST
    if match[4] == "24":  # midnight at the end of a day
        midnight = _moment(match, hour=0)
        return None if midnight is None else _shifted(midnight, timedelta(days=1))
    return _moment(match, hour=int(match[4]))


@lru_cache(maxsize=64)
def cyclone_date(text: str) -> datetime | None:
    """Read a date as Cyclone DDS: years have four digits, zones end at 12:00, and time ends in 2262."""
    match = _DATE.fullmatch(text.strip(BLANKS))
    if match is None or len(match[1]) != len("2262"):
        return None
    if match[7] and (int(match[8]), int(match[9])) > (12, 0):
        return None
    moment = _moment(match, hour=int(match[4]))
    return None if moment is None or moment > _LAST_OF_CYCLONE else moment


@lru_cache(maxsize=64)
def fast_date(text: str) -> datetime | None:
    """Read a date as Fast DDS: everything after the seconds is ignored, and local time is assumed to be UTC."""
    match = _DATE.match(text.lstrip(" \t\n\v\f\r"))
    return _clock(match, hour=int(match[4])) if match and len(match[1]) == len("2026") else None


def _clock(match: re.Match[str], *, hour: int) -> datetime | None:
    """Return the date and time of a match, without its zone."""
    try:
        year, month, day, minute, second = (int(match[index]) for index in (1, 2, 3, 5, 6))
        return datetime(year, month, day, hour, minute, second, tzinfo=UTC)
    except ValueError:
        return None


def _moment(match: re.Match[str], *, hour: int) -> datetime | None:
    moment = _clock(match, hour=hour)
    if moment is None or not match[7]:
        return moment
    if int(match[9]) > _LAST_MINUTE:
        return None
    offset = timedelta(hours=int(match[8]), minutes=int(match[9]))
    return _shifted(moment, -offset if match[7] == "+" else offset)


def _shifted(moment: datetime, by: timedelta) -> datetime:
    try:
        return moment + by
    except OverflowError:
        return _LAST if by > timedelta() else _FIRST


VendorReading = Literal["plain", "refuses", "crashes", "unmodelled"]
"""What a vendor does with a document that has a quirk.

``plain``: it reads the document as if it had none. ``refuses``: it refuses the document. ``crashes``: its process ends.
``unmodelled``: not known.
"""
PLAIN: VendorReading = "plain"
REFUSES: VendorReading = "refuses"
CRASHES: VendorReading = "crashes"
UNMODELLED: VendorReading = "unmodelled"


class Quirk(Data):
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


USUAL_HEAD = f'<?xml version="1.0" encoding="UTF-8"?>\n<dds xmlns:xsi="{XSI}" xsi:noNamespaceSchemaLocation="'
"""What a document of Keymint begins with."""
_UNUSUAL = (b"<!", b"<?", b"&", b"\0", b"xmlns", b"xsi:", b" >", b"\t>", b"\r>", b"\n>")
"""One of these is in each quirk of the bytes that follow."""
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
_MOST_DIGITS, _MOST_PLAIN_DIGITS = 4000, 9


def quirks_of_bytes(content: bytes, *, comments_until: int | None = None) -> Iterator[Quirk]:
    """Yield the quirks of the bytes of a document: its encoding, comments, references, and attributes.

    Args:
        content: the document; it is well-formed XML without a DOCTYPE.
        comments_until: offset up to which comments are ignored; None: everywhere.
    """
    usual = USUAL_HEAD.encode()
    if content.startswith(usual) and not any(each in content[len(usual) :] for each in _UNUSUAL):
        return
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
    if b"<!--" in rest:
        rest = _COMMENTS.sub(lambda match: match[1] + _line_ends(match[2]), rest[:end]) + rest[end:]
    rest = _ATTRIBUTES.sub(lambda match: _line_ends(match[0]), rest)
    for expression, text, cyclone, fast in _MARKUP:
        match = expression.search(rest)
        if match is not None:
            yield Quirk(rest.count(b"\n", 0, match.start()) + 1, text, cyclone, fast)
            if cyclone == fast == UNMODELLED:
                return  # what follows may be part of a comment


def _line_ends(text: bytes) -> bytes:
    return b"\n" * text.count(b"\n")


def quirks_by_schema(
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
        schema.validate(root, "keymint_ros2_dds", kind, file)
    except KeymintError as error:
        first = error.diagnostics[0]
        at = first.where.line if first.where and first.where.line else 1
        text = f"what the schema does not allow ({first.message})"
        return error.diagnostics, (Quirk(at, text, UNMODELLED, UNMODELLED),)
    return (), tuple(sorted(own, key=attrgetter("line")))


def is_number(text: str) -> bool:
    """Tell whether a text has ASCII digits only, and no more than Python reads."""
    return text.isascii() and text.isdecimal() and len(text) <= _MOST_DIGITS


def quirks_of_domain_ids(root: etree._Element) -> Iterator[Quirk]:
    """Yield the quirks of the domain ids of a document that its schema allows."""
    for element in root.iter("id", "min", "max"):
        number = (element.text or "").strip(BLANKS)
        if not is_number(number) or len(number) > _MOST_PLAIN_DIGITS or number != str(int(number)):
            yield Quirk(line(element), f"the domain id {number!r}", UNMODELLED, UNMODELLED)
        elif int(number) > MAX_DOMAIN:
            yield Quirk(line(element), f"a domain id above {MAX_DOMAIN}", REFUSES, PLAIN)
