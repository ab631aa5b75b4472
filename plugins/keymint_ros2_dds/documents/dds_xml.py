"""XML documents as DDS implementations want them: compact text, no comments, no foreign attributes, schema order."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator
from datetime import UTC, datetime

from lxml import etree

from comarmor.data import locate
from comarmor.xml import schema
from comarmor.xml.reader import parse
from keymint.api import DomainRange
from keymint_ros2_dds.domains import merged

INDENTED = 32_000
"""Bytes up to which a document is indented. A sixth of a larger one would be blanks, and handshakes carry it whole.

Line ends stay in either form, so that a line's number says which topic is meant.
"""

_XSI = "http://www.w3.org/2001/XMLSchema-instance"
_SPEC = "http://www.omg.org/spec/DDS-Security/20170901"
_valid: set[bytes] = set()
"""Digests of documents that are known to be valid: a memo, by which most need not be parsed again to be signed."""
_HEAD = b'<?xml version="1.0" encoding="UTF-8"?>\n'


def root(kind: str) -> etree._Element:
    """Return the root element of a document of ``permissions`` or ``governance``."""
    element = etree.Element("dds", nsmap={"xsi": _XSI})
    element.set(f"{{{_XSI}}}noNamespaceSchemaLocation", f"{_SPEC}/omg_shared_ca_{kind}.xsd")
    return element


def child(parent: etree._Element, tag: str, text: str | None = None) -> etree._Element:
    """Append an element, with text or without, and return it."""
    element = etree.SubElement(parent, tag)
    if text is not None:
        element.text = text
    return element


def domains(parent: etree._Element, ranges: Iterable[DomainRange]) -> None:
    """Append ``<domains>``: ``<id>``, or ``<id_range>`` with both of its ends."""
    element = child(parent, "domains")
    for item in merged(ranges):
        if item.first == item.last:
            child(element, "id", str(item.first))
        else:
            both = child(element, "id_range")
            child(both, "min", str(item.first))
            child(both, "max", str(item.last))


def date(moment: datetime) -> str:
    """Return a date as all vendors read it: UTC, to the second, without a zone (which Fast DDS ignores)."""
    return moment.astimezone(UTC).strftime("%Y-%m-%dT%H:%M:%S")


def render(document: etree._Element, kind: str) -> bytes:
    """Return a document as bytes, held against its schema first: indented, unless it is a large one.

    Raises:
        KeymintError: it is not valid.
    """
    validate(document, kind, f"{kind}.xml")
    content = _written(document, "  ")
    if len(content) > INDENTED:
        content = _written(document, "")
    _valid.add(_digest(content, kind))
    return content


def _written(document: etree._Element, space: str) -> bytes:
    etree.indent(document, space=space)
    return _HEAD + etree.tostring(document, encoding="utf-8") + b"\n"


def require_valid(content: bytes, kind: str, name: str) -> None:
    """Hold a document from bytes against its schema, unless it was rendered here, or held against it before.

    Raises:
        KeymintError: it cannot be read or is not valid; each defect with ``file:line``.
    """
    digest = _digest(content, kind)
    if digest not in _valid:
        read(content, kind, name)
        _valid.add(digest)


def _digest(content: bytes, kind: str) -> bytes:
    return hashlib.sha256(kind.encode() + content).digest()


def read(content: bytes, kind: str, name: str) -> etree._Element:
    """Return the root of a document from bytes, held against its schema.

    Args:
        content: XML.
        kind: ``permissions`` or ``governance``.
        name: the file as the user would type it.

    Raises:
        KeymintError: it cannot be read or is not valid; each defect with ``file:line``.
    """
    document = parse(content, name)
    validate(document, kind, name)
    return document


def validate(document: etree._Element, kind: str, name: str) -> None:
    """Hold a document against the schema of its kind.

    Raises:
        KeymintError: it is not valid; each defect with ``file:line``.
    """
    schema.validate(document, locate("keymint_ros2_dds", "schemas") / f"{kind}.xsd", name)


def hazards(content: bytes, root: etree._Element) -> Iterator[str]:
    """Yield what a valid document should not hold, since some vendor misreads it or stops at it; one line each."""
    if b"<!--" in content or b"<?" in content.removeprefix(b"<?xml"):
        yield "has a comment or a processing instruction, which Fast DDS misreads"
    if any(item.find("min") is None or item.find("max") is None for item in root.iter("id_range")):
        yield "has a range of domains without both of its ends, which vendors read differently, or stop at"
    if any(text != text.strip() for item in root.iter() if not len(item) and (text := item.text or "")):
        yield "has white space around a text, which Cyclone DDS trims and Fast DDS keeps"
