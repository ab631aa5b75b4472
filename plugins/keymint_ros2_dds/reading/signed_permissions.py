"""A permissions document as it is signed, read into data types that know their lines.

Read is more than the schema allows, since vendors accept more; :attr:`PermissionsDocument.defects` says what the
schema has against it (DDS Security 1.1, 9.4.1.3).
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

from lxml import etree

from comarmor.data import locate
from comarmor.errors import ComArmorError, Diagnostic, Origin, Severity
from comarmor.xml import schema
from comarmor.xml.reader import line, parse
from keymint.errors import KeymintError
from keymint_ros2_dds.reading import domain_ids, quirks
from keymint_ros2_dds.reading.quirks import Quirk

ACTIONS = ("publish", "subscribe", "relay")
BLANKS = " \t\v\r\n"
"""What is white space for XML, and for Cyclone DDS."""
_RULES = frozenset(("allow_rule", "deny_rule"))
_WHOLE = re.compile(r"[+-]?[0-9]+")


@dataclass(frozen=True, slots=True)
class DocumentDomains:
    """Domain ids from ``first`` to ``last``; None where the document leaves an end of the range open.

    ``texts`` are the numbers as they are written.
    """

    first: int | None
    last: int | None
    texts: tuple[str, ...] = ()

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
    """One ``<publish>``, ``<subscribe>`` or ``<relay>`` of a rule.

    Attributes:
        action: its tag.
        topics: expressions, with the white space around them.
        partitions: expressions; None without ``<partitions>``.
        tags: data tags, name and value; None without ``<data_tags>``.
        line: line of the element.
        listed: there is a ``<topics>``.
    """

    action: str
    topics: tuple[str, ...]
    partitions: tuple[str, ...] | None
    tags: tuple[tuple[str, str], ...] | None
    line: int
    listed: bool = True


@dataclass(frozen=True, slots=True)
class DocumentRule:
    """An ``<allow_rule>`` or a ``<deny_rule>``; it is bounded if there is a ``<domains>``, be it empty."""

    allows: bool
    domains: tuple[DocumentDomains, ...]
    criteria: tuple[DocumentCriteria, ...]
    line: int
    bounded: bool = True


@dataclass(frozen=True, slots=True)
class DocumentGrant:
    """The rights of a subject, for a time.

    Attributes:
        name: its name attribute, or None.
        subject_name: text, with the white space around it.
        not_before: text.
        not_after: text.
        rules: in the order of the document.
        default: text, with the white space around it; None when it is missing.
        before_default: so many of the rules come before the default.
        line: line of the element.
    """

    name: str | None
    subject_name: str
    not_before: str
    not_after: str
    rules: tuple[DocumentRule, ...]
    default: str | None
    before_default: int
    line: int

    @property
    def allows(self) -> bool:
        """What no rule matches is allowed."""
        return self.default is not None and self.default.strip(BLANKS) == "ALLOW"


@dataclass(frozen=True, slots=True, eq=False)
class PermissionsDocument:
    """A permissions document.

    Attributes:
        file: its name, for people.
        grants: in the order of the document.
        defects: what the schema has against it.
        peculiarities: what a plain document has not, and what vendors make of it.
        offset: lines of the file before the document's first one.
    """

    file: str
    grants: tuple[DocumentGrant, ...]
    defects: tuple[Diagnostic, ...]
    peculiarities: tuple[Quirk, ...] = ()
    offset: int = 0
    _views: Mapping[tuple[bool, bool], tuple[DocumentGrant, ...]] = field(default_factory=dict, repr=False)

    @property
    def defect(self) -> str:
        """Why the schema refuses it, or an empty text."""
        return f"the schema refuses it: {self.defects[0]}" if self.defects else ""

    def read_as(self, *, c_numbers: bool, first_piece: bool) -> tuple[DocumentGrant, ...]:
        """Return the grants as another parser reads them.

        Args:
            c_numbers: domain ids are read as in C, where 010 is 8.
            first_piece: a text ends at its first comment or CDATA section.
        """
        return self._views.get((c_numbers, first_piece), self.grants)

    def place(self, line: int) -> Origin:
        """Return a line of the document as a place in its file."""
        return Origin(self.file, line + self.offset)


def read(content: bytes, file: str = "permissions.xml", offset: int = 0) -> PermissionsDocument:
    """Read a permissions document.

    Args:
        content: XML, unsigned.
        file: its name, for people.
        offset: lines of the file before the document's first one.

    Raises:
        KeymintError: it is not well-formed, not a permissions document, or a number in it is none.
    """
    try:
        root = parse(content, file)
    except ComArmorError as error:
        raise KeymintError.of(_diagnostics(error, file, offset)) from None
    if root.tag != "dds" or root.find("permissions") is None:
        where = Origin(file, line(root) + offset)
        raise KeymintError("this is not a permissions document", where=where, code="document-kind")
    defects = _defects(root, file, offset)
    found = quirks.find(content, valid=not defects)
    grants = _PermissionsReader(file, offset).grants(root)
    odd = any(domain_ids.is_odd(t) for g in grants for r in g.rules for d in r.domains for t in d.texts)
    views = {}
    if odd or found.first_pieces:
        firsts = {element: found.first_pieces.get(at) for at, element in enumerate(root.iter())}
        for c_numbers, first_piece in ((True, False), (False, True), (True, True)):
            reader = _PermissionsReader(file, offset, c_numbers=c_numbers, firsts=firsts if first_piece else {})
            views[c_numbers, first_piece] = reader.grants(root)
    return PermissionsDocument(file, grants, defects, found.peculiarities, offset, MappingProxyType(views))


def _defects(root: etree._Element, file: str, offset: int) -> tuple[Diagnostic, ...]:
    try:
        schema.validate(root, locate("keymint_ros2_dds", "schemas") / "permissions.xsd", file)
    except ComArmorError as error:
        return _diagnostics(error, file, offset)
    return ()


def _diagnostics(error: ComArmorError, file: str, offset: int) -> tuple[Diagnostic, ...]:
    return tuple(
        Diagnostic(
            item.code,
            Severity.ERROR,
            item.message,
            Origin(file, item.where.line + offset) if item.where and item.where.line else Origin(file),
            item.help,
        )
        for item in error.diagnostics
    )


@dataclass(frozen=True, slots=True)
class _PermissionsReader:
    """Makes data of elements.

    Attributes:
        file: the document's file, for people.
        offset: lines of it before the document.
        c_numbers: read numbers as in C.
        firsts: texts that are read instead of an element's own.
    """

    file: str
    offset: int
    c_numbers: bool = False
    firsts: Mapping[etree._Element, str | None] = field(default_factory=dict)

    def grants(self, root: etree._Element) -> tuple[DocumentGrant, ...]:
        """Return the grants of a document."""
        return tuple(map(self._grant, root.iterfind("permissions/grant")))

    def _text(self, element: etree._Element | None) -> str:
        if element is None:
            return ""
        first = self.firsts.get(element)
        return (element.text or "") if first is None else first

    def _grant(self, element: etree._Element) -> DocumentGrant:
        children = [str(child.tag) for child in element]
        default = element.find("default")
        end = len(children) if default is None else children.index("default")
        return DocumentGrant(
            element.get("name"),
            self._text(element.find("subject_name")),
            self._text(element.find("validity/not_before")),
            self._text(element.find("validity/not_after")),
            tuple(self._rule(child) for child in element if child.tag in _RULES),
            None if default is None else self._text(default),
            sum(child in _RULES for child in children[:end]),
            line(element),
        )

    def _rule(self, element: etree._Element) -> DocumentRule:
        domains = element.find("domains")
        return DocumentRule(
            element.tag == "allow_rule",
            () if domains is None else tuple(self._domains(domains)),
            tuple(self._criteria(child) for child in element if child.tag in ACTIONS),
            line(element),
            domains is not None,
        )

    def _domains(self, element: etree._Element) -> Iterator[DocumentDomains]:
        for child in element:
            if child.tag == "id":
                number, text = self._number(child)
                yield DocumentDomains(number, number, (text,))
            elif child.tag == "id_range":
                ends = {str(end.tag): self._number(end) for end in reversed(child) if end.tag in {"min", "max"}}
                first, last = (ends[name][0] if name in ends else None for name in ("min", "max"))
                yield DocumentDomains(first, last, tuple(text for _, text in ends.values()))

    def _number(self, element: etree._Element) -> tuple[int, str]:
        text = self._text(element)
        plain = text.strip(BLANKS)
        if _WHOLE.fullmatch(plain) is None:
            where = Origin(self.file, line(element) + self.offset)
            raise KeymintError(f"{plain!r} is no domain id, expected a whole number", where=where, code="domains")
        return (domain_ids.in_c(text) if self.c_numbers else int(plain)), text

    def _criteria(self, element: etree._Element) -> DocumentCriteria:
        topics, partitions, tags = (element.find(name) for name in ("topics", "partitions", "data_tags"))
        return DocumentCriteria(
            str(element.tag),
            tuple(map(self._text, element.iterfind("topics/topic"))),
            None if partitions is None else tuple(map(self._text, partitions.iterfind("partition"))),
            None
            if tags is None
            else tuple((self._text(tag.find("name")), self._text(tag.find("value"))) for tag in tags.iterfind("tag")),
            line(element),
            topics is not None,
        )
