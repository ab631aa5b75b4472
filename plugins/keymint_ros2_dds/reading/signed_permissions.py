# SPDX-License-Identifier: Apache-2.0
"""Read a permissions document into data types that know their lines (DDS Security 1.1, 9.4.1.3).

Documents that the schema does not allow are read as well, since vendors accept some of them.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace

from lxml import etree

from comarmor.errors import ComArmorError, Diagnostic, Origin
from comarmor.xml.reader import line, parse
from keymint.errors import KeymintError
from keymint_ros2_dds.reading import dates, quirks
from keymint_ros2_dds.reading.quirks import BLANKS, CRASHES, PLAIN, REFUSES, UNMODELLED, Quirk

ACTIONS = ("publish", "subscribe", "relay")
_RULES = frozenset(("allow_rule", "deny_rule"))
_NUMBER = re.compile(r"[+-]?[0-9]+")


@dataclass(frozen=True, slots=True)
class DocumentDomains:
    """Domain ids from ``first`` to ``last``; None where the range has no such end."""

    first: int | None
    last: int | None

    def contain(self, domain: int, *, min_only_is_exact: bool) -> bool:
        """Tell whether a domain id is in the range.

        Args:
            domain: DDS domain id.
            min_only_is_exact: a range that has only a minimum is that one domain.
        """
        first, last = self.first or 0, self.last
        if last is None:
            return domain == first if min_only_is_exact else domain >= first
        return first <= domain <= last


@dataclass(frozen=True, slots=True)
class DocumentCriteria:
    """A ``<publish>``, ``<subscribe>`` or ``<relay>`` of a rule.

    Attributes:
        action: its tag.
        topics: expressions, with the white space around them.
        partitions: expressions; None without ``<partitions>``.
        tags: data tags, name and value; None without ``<data_tags>``.
        line: line of the element.
    """

    action: str
    topics: tuple[str, ...]
    partitions: tuple[str, ...] | None
    tags: tuple[tuple[str, str], ...] | None
    line: int


@dataclass(frozen=True, slots=True)
class DocumentRule:
    """An ``<allow_rule>`` or a ``<deny_rule>``."""

    allows: bool
    domains: tuple[DocumentDomains, ...]
    criteria: tuple[DocumentCriteria, ...]
    line: int


@dataclass(frozen=True, slots=True)
class DocumentGrant:
    """The permissions of a subject in a period.

    Attributes:
        subject_name: text, with the white space around it.
        not_before: text.
        not_after: text.
        rules: in the order of the document.
        allows: the default is ALLOW.
        line: line of the element.
    """

    subject_name: str
    not_before: str
    not_after: str
    rules: tuple[DocumentRule, ...]
    allows: bool
    line: int


@dataclass(frozen=True, slots=True, eq=False)
class PermissionsDocument:
    """A permissions document.

    Attributes:
        file: its name, for people.
        grants: in the order of the document.
        defects: how it violates the schema.
        quirks: what may make vendors read it differently from a plain document, by line.
        crash: what crashes Cyclone DDS 0.10 when it reads the document, or None.
        offset: number of lines of the file before the document.
    """

    file: str
    grants: tuple[DocumentGrant, ...]
    defects: tuple[Diagnostic, ...]
    quirks: tuple[Quirk, ...]
    crash: Quirk | None
    offset: int = 0

    @property
    def defect(self) -> str:
        """Why the schema refuses it, or an empty text."""
        return f"the schema refuses it: {self.defects[0]}" if self.defects else ""

    def place(self, line: int) -> Origin:
        """Return a line of the document as a place in its file."""
        return Origin(self.file, line + self.offset)


def read(content: bytes, file: str = "permissions.xml", offset: int = 0) -> PermissionsDocument:
    """Read a permissions document.

    Args:
        content: XML, unsigned.
        file: its name, for people.
        offset: number of lines of the file before the document.

    Raises:
        KeymintError: it is not well-formed, not a permissions document, or a domain id is not a whole number.
    """
    try:
        root = parse(content, file)
    except ComArmorError as error:
        raise KeymintError.of(_diagnostics(error, file, offset)) from None
    if root.tag != "dds" or root.find("permissions") is None:
        where = Origin(file, line(root) + offset)
        raise KeymintError("this is not a permissions document", where=where, code="document-kind")
    violation, document_quirks = quirks.of_schema(root, "permissions", file)
    crash = next(_crashes(root), None)
    if violation is None:
        document_quirks = (
            *quirks.of_bytes(content),
            *quirks.of_domain_ids(root),
            *_quirks(root),
            *filter(None, [crash]),
        )
    return PermissionsDocument(
        file,
        tuple(_grant(element, file, offset) for element in root.iterfind("permissions/grant")),
        _diagnostics(violation, file, offset) if violation else (),
        tuple(sorted(document_quirks, key=lambda quirk: quirk.line)),
        crash,
        offset,
    )


def _diagnostics(error: ComArmorError, file: str, offset: int) -> tuple[Diagnostic, ...]:
    return tuple(
        replace(item, where=Origin(file, item.where.line + offset) if item.where and item.where.line else Origin(file))
        for item in error.diagnostics
    )


def _crashes(root: etree._Element) -> Iterator[Quirk]:
    """Yield what crashes Cyclone DDS 0.10, also of a document that the schema does not allow."""
    for rule in root.iter(*_RULES):
        if rule.find("domains") is None:
            yield Quirk(line(rule), "a rule without domains", CRASHES, PLAIN)
        for element in rule.iterfind("domains/id_range"):
            if element.find("min") is None:
                yield Quirk(line(element), "a range of domains without a minimum", CRASHES, PLAIN)
        for action in ("publish", "subscribe"):
            for element in rule.iterfind(f"{action}/topics/topic"):
                if not _text(element).strip(BLANKS):
                    yield Quirk(line(element), "an empty topic", CRASHES, PLAIN)
    for element in root.iter("default"):
        if not _text(element).strip(BLANKS):
            yield Quirk(line(element), "an empty <default>", CRASHES, PLAIN)


def _quirks(root: etree._Element) -> Iterator[Quirk]:
    """Yield the quirks of the texts of a document that its schema allows."""
    for element in root.iter("subject_name", "not_before", "not_after", "topic", "partition"):
        text = _text(element)
        bare = text.strip(BLANKS)
        if element.tag == "subject_name":
            if not bare:
                yield Quirk(line(element), "a grant without a subject name", REFUSES, REFUSES)
        elif element.tag in {"not_before", "not_after"}:
            if dates.fast(text) is None:
                yield Quirk(line(element), f"the date {text!r}", PLAIN, UNMODELLED)
        else:
            if "\n" in bare:
                # Cyclone DDS keeps the carriage return that S/MIME puts before it.
                yield Quirk(line(element), "a line end within a name", UNMODELLED, PLAIN)
            if not bare and element.tag == "topic":
                yield Quirk(line(element), "an empty topic", PLAIN, REFUSES)


def _text(element: etree._Element | None) -> str:
    return "" if element is None else element.text or ""


def _grant(element: etree._Element, file: str, offset: int) -> DocumentGrant:
    return DocumentGrant(
        _text(element.find("subject_name")),
        _text(element.find("validity/not_before")),
        _text(element.find("validity/not_after")),
        tuple(_rule(child, file, offset) for child in element if child.tag in _RULES),
        _text(element.find("default")) == "ALLOW",
        line(element),
    )


def _rule(element: etree._Element, file: str, offset: int) -> DocumentRule:
    domains = element.find("domains")
    return DocumentRule(
        element.tag == "allow_rule",
        () if domains is None else tuple(_domains(domains, file, offset)),
        tuple(_criteria(child) for child in element if child.tag in ACTIONS),
        line(element),
    )


def _domains(domains: etree._Element, file: str, offset: int) -> Iterator[DocumentDomains]:
    for element in domains:
        if element.tag == "id":
            number = _number(element, file, offset)
            yield DocumentDomains(number, number)
        elif element.tag == "id_range":
            ends = {str(end.tag): _number(end, file, offset) for end in element if end.tag in {"min", "max"}}
            yield DocumentDomains(ends.get("min"), ends.get("max"))


def _number(element: etree._Element, file: str, offset: int) -> int:
    text = _text(element).strip(BLANKS)
    if _NUMBER.fullmatch(text) is None:
        where = Origin(file, line(element) + offset)
        raise KeymintError(f"{text!r} is no domain id, expected a whole number", where=where, code="domains")
    return int(text)


def _criteria(element: etree._Element) -> DocumentCriteria:
    partitions, tags = element.find("partitions"), element.find("data_tags")
    return DocumentCriteria(
        str(element.tag),
        tuple(map(_text, element.iterfind("topics/topic"))),
        None if partitions is None else tuple(map(_text, partitions.iterfind("partition"))),
        None
        if tags is None
        else tuple((_text(tag.find("name")), _text(tag.find("value"))) for tag in tags.iterfind("tag")),
        line(element),
    )
