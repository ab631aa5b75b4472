# SPDX-License-Identifier: Apache-2.0
"""Read a permissions document into data types that know their lines (DDS Security 1.1, 9.4.1.3).

Documents that the schema does not allow are read as well, since vendors accept some of them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from functools import lru_cache
from itertools import chain

from lxml import etree

from comarmor.errors import ComArmorError, Diagnostic, Origin
from comarmor.text import quote
from comarmor.values import Data, replace
from comarmor.xml.reader import XSI, line, parse
from keymint.api import DomainRange
from keymint.errors import KeymintError
from keymint_ros2_dds.domains import MAX_DOMAIN
from keymint_ros2_dds.reading import dialects
from keymint_ros2_dds.reading.dialects import BLANKS, CRASHES, PLAIN, REFUSES, UNMODELLED, Quirk

ACTIONS = ("publish", "subscribe", "relay")
_RULES = frozenset(("allow_rule", "deny_rule"))


class DocumentDomains(Data):
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


def as_ranges(domains: Iterable[DocumentDomains]) -> Iterator[DomainRange]:
    """Yield the domains of a document; a range without a maximum is its minimum, as vendors read it."""
    for each in domains:
        first = each.first or 0
        yield DomainRange(first, first if each.last is None else each.last)


class DocumentCriteria(Data):
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


class DocumentRule(Data):
    """An ``<allow_rule>`` or a ``<deny_rule>``."""

    allows: bool
    domains: tuple[DocumentDomains, ...]
    criteria: tuple[DocumentCriteria, ...]
    line: int


class DocumentGrant(Data):
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


class PermissionsDocument(Data, eq=False):
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
    if (plain := _plain(content)) is not None:
        return PermissionsDocument(file, plain, (), (), None, offset)
    try:
        root = parse(content, file, limits=dialects.DOCUMENT_LIMITS)
        if root.tag != "dds" or root.find("permissions") is None:
            where = Origin(file, line(root))
            raise KeymintError("this is not a permissions document", where=where, code="document-kind")
        grants = tuple(map(_grant, root.iterfind("permissions/grant")))
    except ComArmorError as error:
        raise KeymintError.of(defects_in_file(error.diagnostics, file, offset)) from None
    crash = next(_crashes(root), None)
    own = chain(
        dialects.quirks_of_bytes(content), dialects.quirks_of_domain_ids(root), _quirks(root), filter(None, [crash])
    )
    defects, document_quirks = dialects.quirks_by_schema(root, "permissions", file, own)
    return PermissionsDocument(file, grants, defects_in_file(defects, file, offset), document_quirks, crash, offset)


_DATE_LENGTH = len("2026-01-01T00:00:00")
_LOCATION = f"{{{XSI}}}noNamespaceSchemaLocation"


def _plain_text(location: str, name: str, grant: DocumentGrant) -> str:
    """Return a document as Keymint writes it, unindented: if it is valid, each vendor reads it alike."""
    rules, default = "".join(map(_plain_rule, grant.rules)), "ALLOW" if grant.allows else "DENY"
    return (
        f'{dialects.USUAL_HEAD}{location}">\n<permissions>\n<grant name="{name}">\n'
        f"<subject_name>{grant.subject_name}</subject_name>\n<validity>\n<not_before>{grant.not_before}</not_before>\n"
        f"<not_after>{grant.not_after}</not_after>\n</validity>\n{rules}<default>{default}</default>\n</grant>\n"
        "</permissions>\n</dds>\n"
    )


def _plain_rule(rule: DocumentRule) -> str:
    tag = "allow_rule" if rule.allows else "deny_rule"
    domains = [
        f"<id>{each.first}</id>\n"
        if each.first == each.last
        else f"<id_range>\n<min>{each.first}</min>\n<max>{each.last}</max>\n</id_range>\n"
        for each in rule.domains
    ]
    criteria = "".join(map(_plain_criteria, sorted(rule.criteria, key=lambda each: ACTIONS.index(each.action))))
    return f"<{tag}>\n<domains>\n{''.join(domains)}</domains>\n{criteria}</{tag}>\n"


def _plain_criteria(criteria: DocumentCriteria) -> str:
    texts = "</topic>\n<topic>".join(criteria.topics)
    topics = f"<topics>\n<topic>{texts}</topic>\n</topics>\n"
    partitions = ""
    if criteria.partitions is not None:
        texts = "</partition>\n<partition>".join(criteria.partitions)
        partitions = f"<partitions>\n<partition>{texts}</partition>\n</partitions>\n"
    return f"<{criteria.action}>\n{topics}{partitions}</{criteria.action}>\n"


_PLAIN_MOST = 1 << 20
_MOST_LINES = (1 << 16) - 1
"""Lines that lxml counts by itself."""


def is_plain(content: bytes) -> bool:
    """Tell whether a document is valid, and has nothing that a vendor may read differently or crash on."""
    grants = _plain(content)
    return grants is not None and all(grant.subject_name == grant.subject_name.strip() for grant in grants)


@lru_cache(maxsize=4)
def _plain(content: bytes) -> tuple[DocumentGrant, ...] | None:
    """Return the grant of a document in the form in which Keymint writes it, fast; None for any other document."""
    if (
        len(content) > _PLAIN_MOST
        or content.count(b"\n") >= _MOST_LINES
        or not content.isascii()
        or not content.startswith(dialects.USUAL_HEAD.encode())
        or (content.count(b"xmlns"), content.count(b"xsi:")) != (1, 1)
    ):
        return None
    try:
        # Its head leaves no place for a DOCTYPE, and it is far below every limit, so that lxml alone may parse it.
        root = etree.fromstring(content)
        (grant,) = map(_grant, grants := root.findall("permissions/grant"))
    except (etree.XMLSyntaxError, KeymintError, ValueError):
        return None
    location, name = root.get(_LOCATION, ""), grants[0].get("name", "")
    unindented = "\n".join([line.lstrip(" ") for line in content.decode().split("\n")])
    is_plain = unindented == _plain_text(location, name, grant) and _is_valid(location, name, grant)
    return (grant,) if is_plain else None


def _is_valid(location: str, name: str, grant: DocumentGrant) -> bool:
    """Tell whether the schema allows what such a document says, and each vendor reads its texts alike."""
    rules, dates = grant.rules, (grant.not_before, grant.not_after)
    criteria = [each for rule in rules for each in rule.criteria]
    topics = list(chain.from_iterable(each.topics for each in criteria))
    partitions = chain.from_iterable(each.partitions or () for each in criteria)
    words = "".join((location, grant.subject_name[:1], *topics, *partitions))
    texts = f"{words}{grant.subject_name}{name}"
    ends = [end or 0 for rule in rules for each in rule.domains for end in (each.first, each.last)]
    return (
        all((grant.subject_name, *topics, *(rule.domains for rule in rules)))
        and texts.isprintable()
        and ">" not in texts
        and " " not in words
        and all(0 <= end <= MAX_DOMAIN for end in ends)
        and all(len(date) == _DATE_LENGTH and dialects.fast_date(date) for date in dates)
    )


def defects_in_file(defects: Iterable[Diagnostic], file: str, offset: int) -> tuple[Diagnostic, ...]:
    """Return the defects of a document, with their places in the file that has it."""
    return tuple(
        replace(item, where=Origin(file, item.where.line + offset) if item.where and item.where.line else Origin(file))
        for item in defects
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
                if not raw_text(element).strip(BLANKS):
                    yield Quirk(line(element), "an empty topic", CRASHES, PLAIN)
    for element in root.iter("default"):
        if not raw_text(element).strip(BLANKS):
            yield Quirk(line(element), "an empty <default>", CRASHES, PLAIN)


def _quirks(root: etree._Element) -> Iterator[Quirk]:
    """Yield the quirks of the texts of a document that its schema allows."""
    for element in root.iter("subject_name", "not_before", "not_after", "topic", "partition"):
        text = raw_text(element)
        bare = text.strip(BLANKS)
        if element.tag == "subject_name":
            if not bare:
                yield Quirk(line(element), "a grant without a subject name", REFUSES, REFUSES)
        elif element.tag in {"not_before", "not_after"}:
            if dialects.fast_date(text) is None:
                yield Quirk(line(element), f"the date {text!r}", PLAIN, UNMODELLED)
        else:
            if "\n" in bare:
                # Cyclone DDS keeps the carriage return that S/MIME puts before it.
                yield Quirk(line(element), "a line end within a name", UNMODELLED, PLAIN)
            if not bare and element.tag == "topic":
                yield Quirk(line(element), "an empty topic", PLAIN, REFUSES)


def raw_text(element: etree._Element | None) -> str:
    """Return the text of an element as it is written; empty if there is no such element."""
    return "" if element is None else element.text or ""


def _grant(element: etree._Element) -> DocumentGrant:
    return DocumentGrant(
        raw_text(element.find("subject_name")),
        raw_text(element.find("validity/not_before")),
        raw_text(element.find("validity/not_after")),
        tuple(_rule(child) for child in element if child.tag in _RULES),
        raw_text(element.find("default")) == "ALLOW",
        line(element),
    )


def _rule(element: etree._Element) -> DocumentRule:
    return DocumentRule(
        element.tag == "allow_rule",
        tuple(document_domains(element.find("domains"), _number)),
        tuple(_criteria(child) for child in element if child.tag in ACTIONS),
        line(element),
    )


def document_domains(
    domains: etree._Element | None, number: Callable[[etree._Element], int | None]
) -> Iterator[DocumentDomains]:
    """Yield the ranges of a ``<domains>``; ``number`` reads the text of an element, or returns None."""
    for element in () if domains is None else domains:
        if element.tag == "id":
            yield DocumentDomains(number(element), number(element))
        elif element.tag == "id_range":
            ends = {str(end.tag): number(end) for end in element if end.tag in {"min", "max"}}
            yield DocumentDomains(ends.get("min"), ends.get("max"))


def _number(element: etree._Element) -> int:
    text = raw_text(element).strip(BLANKS)
    if not dialects.is_number(text[1:] if text.startswith(("+", "-")) else text):
        where = Origin("", line(element))
        raise KeymintError(f"{quote(text)} is no domain id, expected a whole number", where=where, code="domains")
    return int(text)


def _criteria(element: etree._Element) -> DocumentCriteria:
    partitions, tags = element.find("partitions"), element.find("data_tags")
    return DocumentCriteria(
        str(element.tag),
        tuple(map(raw_text, element.iterfind("topics/topic"))),
        None if partitions is None else tuple(map(raw_text, partitions.iterfind("partition"))),
        None
        if tags is None
        else tuple((raw_text(tag.find("name")), raw_text(tag.find("value"))) for tag in tags.iterfind("tag")),
        line(element),
    )
