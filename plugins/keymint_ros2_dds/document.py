"""XML documents as DDS implementations want them: compact text, no comments, no foreign attributes, schema order."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from datetime import UTC, datetime

from lxml import etree

from comarmor import schema
from comarmor.errors import ComArmorError, Location
from comarmor.reader import parse
from keymint.api import DomainRange
from keymint.errors import Diagnostic, KeymintError, Origin, Severity

PERMISSIONS = "permissions"
GOVERNANCE = "governance"
MAX_DOMAIN = 230
"""The highest domain id whose ports exist (DDSI-RTPS 2.3, 9.6.1.1); Cyclone DDS refuses documents with higher ones."""
MAX_YEAR = 2261
"""Cyclone DDS counts time in nanoseconds of 64 bits, and takes later years to be over."""

_XSI = "http://www.w3.org/2001/XMLSchema-instance"
_SPEC = "http://www.omg.org/spec/DDS-Security/20170901"
_HEAD = b'<?xml version="1.0" encoding="UTF-8"?>\n'


def root(kind: str) -> etree._Element:
    """Return the root element of a document of :data:`PERMISSIONS` or :data:`GOVERNANCE`."""
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


def merged(ranges: Iterable[DomainRange]) -> Sequence[DomainRange]:
    """Return ranges of domains sorted, those that overlap or touch as one."""
    found: list[DomainRange] = []
    for item in sorted(ranges):
        if found and item.first <= found[-1].last + 1:
            found[-1] = DomainRange(found[-1].first, max(found[-1].last, item.last))
        else:
            found.append(item)
    return found


def check_domains(ranges: Sequence[DomainRange], where: Origin, subject: str) -> list[Diagnostic]:
    """Return what is wrong with a list of domains: none, an empty range, or an id that has no ports."""
    if not ranges:
        return [Diagnostic("domains", Severity.ERROR, "no domain is given", where, "name at least one", subject)]
    found = []
    for item in ranges:
        if item.first > item.last or item.first < 0:
            message = f"the range of domains {item.first} to {item.last} is empty"
            found.append(Diagnostic("domains", Severity.ERROR, message, where, "put the lower id first", subject))
        elif item.last > MAX_DOMAIN:
            message = f"domain {item.last} is higher than {MAX_DOMAIN}; Cyclone DDS refuses the whole document"
            found.append(
                Diagnostic("portability-domain", Severity.ERROR, message, where, f"use 0 to {MAX_DOMAIN}", subject)
            )
    return found


def date(moment: datetime) -> str:
    """Return a date as all vendors read it: UTC, to the second, without a zone (which Fast DDS ignores)."""
    return moment.astimezone(UTC).strftime("%Y-%m-%dT%H:%M:%S")


def render(document: etree._Element, kind: str) -> bytes:
    """Return a document as bytes, held against its schema first.

    Raises:
        KeymintError: it is not valid.
    """
    validate(document, kind, f"{kind}.xml")
    etree.indent(document)
    return _HEAD + etree.tostring(document, encoding="utf-8") + b"\n"


def read(content: bytes, kind: str, name: str) -> etree._Element:
    """Return the root of a document from bytes, held against its schema.

    Args:
        content: XML.
        kind: :data:`PERMISSIONS` or :data:`GOVERNANCE`.
        name: the file as the user would type it.

    Raises:
        KeymintError: it cannot be read or is not valid; each defect with ``file:line``.
    """
    try:
        document = parse(content, name)
    except ComArmorError as error:
        raise _converted(error) from None
    validate(document, kind, name)
    return document


def validate(document: etree._Element, kind: str, name: str) -> None:
    """Hold a document against the schema of its kind.

    Raises:
        KeymintError: it is not valid; each defect with ``file:line``.
    """
    try:
        schema.validate(document, f"dds/{kind}.xsd", name)
    except ComArmorError as error:
        raise _converted(error) from None


def _converted(error: ComArmorError) -> KeymintError:
    return KeymintError.of(
        Diagnostic(item.code, Severity.ERROR, item.message, _origin(item.where), item.help)
        for item in error.diagnostics
    )


def _origin(where: Location | None) -> Origin | None:
    return Origin(where.file, where.line) if where else None
