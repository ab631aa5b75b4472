"""A governance document as it is signed (DDS Security 1.1, 9.4.1.2), read into data types that know their lines.

It says of each domain who may join, and of each topic whether permissions are asked at all. The first domain rule that
is about a domain counts, and in it the first topic rule that is about a topic; a topic without a rule is refused.

The models of vendors hold for plain documents: elements in the order of the schema, text without decoration. What a
vendor refuses otherwise is stated where it was measured (Cyclone DDS 0.10.2, Fast DDS 2.9.1); of everything else
there is no verdict.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

from lxml import etree

from comarmor.data import locate
from comarmor.errors import ComArmorError, Origin
from comarmor.xml import schema
from comarmor.xml.reader import line, parse
from keymint.errors import KeymintError
from keymint_ros2_dds.domains import MAX_DOMAIN
from keymint_ros2_dds.layout import GOVERNANCE, GOVERNANCE_XML
from keymint_ros2_dds.reading.quirks import FINE, REFUSES, UNMODELLED, Quirk, decorations
from keymint_ros2_dds.reading.signed_permissions import DocumentDomains

ACCESS = {"publish": "enable_write_access_control", "subscribe": "enable_read_access_control"}
"""The element that puts an action under access control."""
JOIN, UNAUTHENTICATED = "enable_join_access_control", "allow_unauthenticated_participants"
DOMAIN_PROTECTIONS = ("discovery_protection_kind", "liveliness_protection_kind", "rtps_protection_kind")
TOPIC_PROTECTIONS = (
    "enable_discovery_protection", "enable_liveliness_protection", "metadata_protection_kind", "data_protection_kind",
)  # fmt: skip
_DOMAIN_RULE = ("domains", UNAUTHENTICATED, JOIN, *DOMAIN_PROTECTIONS, "topic_access_rules")
_TOPIC_RULE = (
    "topic_expression", *TOPIC_PROTECTIONS[:2], ACCESS["subscribe"], ACCESS["publish"], *TOPIC_PROTECTIONS[2:],
)  # fmt: skip
_BOOLEANS = {"true": True, "1": True, "false": False, "0": False}
_PLAIN_NUMBER = re.compile(r"0|[1-9][0-9]{0,8}")
_BLANKS = " \t\r\n"


@dataclass(frozen=True, slots=True)
class DocumentTopicRule:
    """How the topics that an expression matches are protected.

    Attributes:
        expression: as it is written.
        read_controlled: permissions are asked before a topic is subscribed to.
        write_controlled: permissions are asked before a topic is published.
        protections: the text of the elements of :data:`TOPIC_PROTECTIONS`, in this order.
        line: line of the element.
    """

    expression: str
    read_controlled: bool
    write_controlled: bool
    protections: tuple[str, ...]
    line: int

    def controls(self, action: str) -> bool:
        """Tell whether permissions are asked for ``publish`` or ``subscribe``."""
        return self.write_controlled if action == "publish" else self.read_controlled


@dataclass(frozen=True, slots=True)
class DocumentDomainRule:
    """How some domains are protected.

    Attributes:
        domains: the domains.
        join_controlled: a participant needs a rule of its permissions to join.
        unauthenticated: a participant may be without identity and permissions.
        protections: the text of the elements of :data:`DOMAIN_PROTECTIONS`, in this order.
        topic_rules: in the order of the document.
        line: line of the element.
        lines: of those of its elements that are no lists, by tag.
    """

    domains: tuple[DocumentDomains, ...]
    join_controlled: bool
    unauthenticated: bool
    protections: tuple[str, ...]
    topic_rules: tuple[DocumentTopicRule, ...]
    line: int
    lines: tuple[tuple[str, int], ...] = ()

    @property
    def joins_without_rule(self) -> bool:
        """Whether a participant needs no rule to join: joining is not controlled, or some topic is not (1.1, 9.4.3)."""
        return not self.join_controlled or not all(
            rule.read_controlled and rule.write_controlled for rule in self.topic_rules
        )

    def line_of(self, tag: str) -> int:
        """Return the line of an element; the rule's where there is none."""
        return dict(self.lines).get(tag, self.line)


@dataclass(frozen=True, slots=True)
class GovernanceDocument:
    """A governance document.

    Attributes:
        file: its name, for people.
        domain_rules: in the order of the document.
        schema_says: what the schema has against it, or an empty text, and in which line.
        peculiarities: what a plain document has not, and what vendors make of it.
        offset: lines of the file before the document's first one.
    """

    file: str
    domain_rules: tuple[DocumentDomainRule, ...]
    schema_says: tuple[str, int]
    peculiarities: tuple[Quirk, ...]
    offset: int = 0

    @property
    def defect(self) -> str:
        """Why the schema refuses it, or an empty text."""
        text, at = self.schema_says
        return f"{self.place(at)}: the schema refuses it: {text}" if text else ""

    def place(self, line: int) -> Origin:
        """Return a line of the document as a place in its file."""
        return Origin(self.file, line + self.offset)

    def rule(self, domain: int, *, min_only_is_exact: bool = False) -> DocumentDomainRule | None:
        """Return the rule that counts in a domain, or None if there is none.

        Args:
            domain: DDS domain id.
            min_only_is_exact: a range with a minimum alone is that one domain.
        """
        for rule in self.domain_rules:
            if any(each.contain(domain, min_only_is_exact=min_only_is_exact) for each in rule.domains):
                return rule
        return None


def read(content: bytes, file: str = GOVERNANCE_XML, offset: int = 0) -> GovernanceDocument:
    """Read a governance document.

    Args:
        content: XML, unsigned.
        file: its name, for people.
        offset: lines of the file before the document's first one.

    Raises:
        KeymintError: it is not well-formed, or not a governance document.
    """
    try:
        return replace(_read(content), file=file, offset=offset)
    except KeymintError as error:
        first = error.diagnostics[0]
        where = Origin(file, first.where.line + offset if first.where and first.where.line else 0)
        raise KeymintError(first.message, where=where, help=first.help, code=first.code) from None


# As a rule all enclaves have the same governance.
@lru_cache(maxsize=64)
def _read(content: bytes) -> GovernanceDocument:
    try:
        root = parse(content, GOVERNANCE_XML)
    except ComArmorError as error:
        first = error.diagnostics[0]
        place = Origin(GOVERNANCE_XML, first.where.line if first.where else 0)
        raise KeymintError(first.message, where=place, help=first.help, code=first.code) from None
    if root.tag != "dds" or root.find("domain_access_rules") is None:
        where = Origin(GOVERNANCE_XML, line(root))
        raise KeymintError("this is not a governance document", where=where, code="document-kind")
    said = _schema_says(root)
    peculiarities = sorted(_peculiarities(content, root, *said), key=lambda each: each.line)
    rules = tuple(map(_domain_rule, root.iterfind("domain_access_rules/domain_rule")))
    return GovernanceDocument(GOVERNANCE_XML, rules, said, tuple(peculiarities))


def _schema_says(root: etree._Element) -> tuple[str, int]:
    """Return what the schema has against a document, with its line in the document; or an empty text."""
    try:
        schema.validate(root, locate("keymint_ros2_dds", "schemas") / f"{GOVERNANCE}.xsd", GOVERNANCE_XML)
    except ComArmorError as error:
        first = error.diagnostics[0]
        return first.message, first.where.line if first.where and first.where.line else 1
    return "", 0


def _domain_rule(element: etree._Element) -> DocumentDomainRule:
    return DocumentDomainRule(
        tuple(_domains(element.find("domains"))),
        _is_true(element, JOIN),
        _is_true(element, UNAUTHENTICATED, otherwise=False),
        tuple(_text(element.find(tag)) for tag in DOMAIN_PROTECTIONS),
        tuple(map(_topic_rule, element.iterfind("topic_access_rules/topic_rule"))),
        line(element),
        tuple((str(child.tag), line(child)) for child in element if not len(child)),
    )


def _topic_rule(element: etree._Element) -> DocumentTopicRule:
    return DocumentTopicRule(
        _raw(element.find("topic_expression")),
        _is_true(element, ACCESS["subscribe"]),
        _is_true(element, ACCESS["publish"]),
        tuple(_text(element.find(tag)) for tag in TOPIC_PROTECTIONS),
        line(element),
    )


def _domains(element: etree._Element | None) -> Iterator[DocumentDomains]:
    for child in () if element is None else element:
        if child.tag == "id" and (number := _number(child)) is not None:
            yield DocumentDomains(number, number)
        elif child.tag == "id_range":
            first, last = (_number(child.find(tag)) for tag in ("min", "max"))
            if first is not None or last is not None:
                yield DocumentDomains(first, last)


def _number(element: etree._Element | None) -> int | None:
    text = _text(element)
    return int(text) if re.fullmatch(r"\+?[0-9]{1,4000}", text, re.ASCII) else None


def _raw(element: etree._Element | None) -> str:
    return "" if element is None else element.text or ""


def _text(element: etree._Element | None) -> str:
    return _raw(element).strip(_BLANKS)


def _is_true(element: etree._Element, tag: str, *, otherwise: bool = True) -> bool:
    """Return a boolean; the schema refuses a document in which it is missing, or none."""
    return _BOOLEANS.get(_text(element.find(tag)), otherwise)


def _peculiarities(content: bytes, root: etree._Element, defect: str, at: int) -> Iterator[Quirk]:
    inner_end = content.find(b"</domain_access_rules>")
    yield from decorations(content, comments_until=inner_end)
    if defect:
        missing = _only_missing(root)
        if missing is None:
            yield Quirk(at, "what the schema does not allow", UNMODELLED, UNMODELLED, invalid=True)
        else:
            tag, where = missing
            yield Quirk(where, f"a rule without <{tag}>", REFUSES, REFUSES, invalid=True)
    for element in root.iter():
        if len(element):
            continue
        text = _raw(element)
        if text != text.strip(_BLANKS):
            yield Quirk(line(element), f"white space around the text of <{element.tag}>", UNMODELLED, UNMODELLED)
        elif "\n" in text or "\r" in text:
            yield Quirk(line(element), f"a line end within the text of <{element.tag}>", UNMODELLED, UNMODELLED)
        elif element.tag in {"id", "min", "max"}:
            yield from _odd_number(element, text)
    for element in root.iter("id_range"):
        first, last = (_number(element.find(tag)) for tag in ("min", "max"))
        if first is None or (last is not None and last < first):
            yield Quirk(line(element), "a range of domains that is not in order", REFUSES, FINE)


def _odd_number(element: etree._Element, text: str) -> Iterator[Quirk]:
    if _PLAIN_NUMBER.fullmatch(text) is None:
        yield Quirk(line(element), f"the domain id {text!r}", UNMODELLED, UNMODELLED)
    elif int(text) > MAX_DOMAIN:
        yield Quirk(line(element), f"a domain id above {MAX_DOMAIN}", REFUSES, FINE)


def _only_missing(root: etree._Element) -> tuple[str, int] | None:
    """Return an element that is missing and the line where, if nothing else is wrong with the order of elements."""
    found: tuple[str, int] | None = None
    for path, order in (("domain_rule", _DOMAIN_RULE), ("domain_rule/topic_access_rules/topic_rule", _TOPIC_RULE)):
        for element in root.iterfind(f"domain_access_rules/{path}"):
            tags = [str(child.tag) for child in element]
            if not _is_part_of(tags, order):
                return None
            if "topic_expression" in order and "topic_expression" not in tags:
                return None  # Cyclone DDS stops at it
            lacking = [tag for tag in order if tag not in tags]
            if lacking and found is None:
                found = lacking[0], line(element)
    return found


def _is_part_of(tags: Sequence[str], order: Sequence[str]) -> bool:
    """Tell whether tags are some of those of an order, each once and in that order."""
    rest = iter(order)
    return all(tag in rest for tag in tags)
