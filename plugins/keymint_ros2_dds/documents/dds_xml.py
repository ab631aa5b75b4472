# SPDX-License-Identifier: Apache-2.0
"""DDS Security documents in the XML form that all vendors read: compact text, no comments, schema order."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from datetime import UTC, datetime
from functools import lru_cache

from lxml import etree

from comarmor.xml import schema
from comarmor.xml.reader import parse
from keymint.api import DomainRange
from keymint_ros2_dds.domains import merged_domains

INDENTED = 32_000
"""Bytes up to which a document is indented. Indentation is a sixth of a larger one, and every handshake carries it.

Both forms have line ends, so that a line number identifies a topic.
"""

_XSI = "http://www.w3.org/2001/XMLSchema-instance"
_SPEC = "http://www.omg.org/spec/DDS-Security/20170901"
_valid: set[bytes] = set()
"""Digests of valid documents, so that most documents are not parsed again before they are signed."""
_HEAD = b'<?xml version="1.0" encoding="UTF-8"?>\n'


def root(kind: str) -> etree._Element:
    """Return the root element of a document of ``permissions`` or ``governance``."""
    return etree.fromstring(f"{start(kind)}</dds>")


def start(kind: str) -> str:
    """Return the start tag of a document of ``permissions`` or ``governance``."""
    return f'<dds xmlns:xsi="{_XSI}" xsi:noNamespaceSchemaLocation="{_SPEC}/omg_shared_ca_{kind}.xsd">'


def child(parent: etree._Element, tag: str, text: str | None = None) -> etree._Element:
    """Append an element and return it."""
    element = etree.SubElement(parent, tag)
    element.text = text
    return element


def settings(parent: etree._Element, values: Mapping[str, str | bool]) -> None:
    """Append an element for each setting: texts as they are, booleans as XML has them."""
    for tag, value in values.items():
        child(parent, tag, value if isinstance(value, str) else str(value).lower())


def topic_rule(parent: etree._Element, expression: str, values: Mapping[str, str | bool]) -> None:
    """Append a topic rule of a governance, with all of its settings in the order of a document."""
    settings(child(parent, "topic_rule"), {"topic_expression": expression, **values})


def domains(parent: etree._Element, ranges: Iterable[DomainRange]) -> None:
    """Append ``<domains>`` with an ``<id>``, or an ``<id_range>`` with both ends, for each range."""
    element = child(parent, "domains")
    for item in merged_domains(ranges):
        if item.first == item.last:
            child(element, "id", str(item.first))
        else:
            id_range = child(element, "id_range")
            child(id_range, "min", str(item.first))
            child(id_range, "max", str(item.last))


@lru_cache(maxsize=64)
def date(moment: datetime) -> str:
    """Return a date in the form that all vendors read: UTC, to the second, without a zone (Fast DDS ignores zones)."""
    return moment.astimezone(UTC).strftime("%Y-%m-%dT%H:%M:%S")


def render(document: etree._Element, kind: str) -> bytes:
    """Return a document as bytes, valid against its schema.

    Raises:
        KeymintError: the document is not valid.
    """

    def serialized(indentation: str) -> str:
        etree.indent(document, indentation)
        return etree.tostring(document, encoding="unicode")

    content = indented_if_small(serialized)
    require_valid(content, kind, f"{kind}.xml")
    return content


def indented_if_small(write: Callable[[str], str]) -> bytes:
    """Return a document as bytes, indented unless it is large.

    Args:
        write: returns the document as text, without declaration, for the text by which each level is indented.
    """
    for indentation in ("  ", ""):
        content = _HEAD + write(indentation).encode() + b"\n"
        if len(content) <= INDENTED:
            break
    return content


def know_valid(content: bytes, kind: str) -> None:
    """Remember that a document is valid against its schema."""
    _valid.add(_digest(content, kind))


def require_valid(content: bytes, kind: str, name: str) -> None:
    """Validate a document against the schema of its kind, unless that was done before.

    Args:
        content: XML.
        kind: ``permissions`` or ``governance``.
        name: the path of the file, for messages.

    Raises:
        KeymintError: the document cannot be read or is not valid; each defect with ``file:line``.
    """
    if _digest(content, kind) not in _valid:
        schema.validate(parse(content, name), "keymint_ros2_dds", kind, name)
        know_valid(content, kind)


def _digest(content: bytes, kind: str) -> bytes:
    return hashlib.sha256(kind.encode() + content).digest()


@lru_cache(maxsize=16)
def hazards(content: bytes) -> tuple[str, ...]:
    """Return the defects of a valid document that some vendor misreads or crashes on; most have the same governance."""
    return tuple(_hazards(content, parse(content, "document")))


def _hazards(content: bytes, root: etree._Element) -> Iterator[str]:
    if b"<!--" in content or b"<?" in content.removeprefix(b"<?xml"):
        yield "has a comment or a processing instruction, which Fast DDS misreads"
    if any(item.find("min") is None or item.find("max") is None for item in root.iter("id_range")):
        yield "has a range of domains with one end only, which vendors read differently or crash on"
    if any(text != text.strip() for item in root.iter() if not len(item) and (text := item.text or "")):
        yield "has white space around a text, which Cyclone DDS trims and Fast DDS keeps"
