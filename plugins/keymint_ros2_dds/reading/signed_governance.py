# SPDX-License-Identifier: Apache-2.0
"""Read a governance document into data types that know their lines (DDS Security 1.1, 9.4.1.2).

It determines who may join a domain, and for which topics permissions are checked. The first domain rule that contains a
domain applies, and in it the first topic rule that matches a topic; a topic without a rule is refused.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache

from lxml import etree

from comarmor.values import Data, replace
from comarmor.xml.reader import line, parse
from keymint.errors import Diagnostic, KeymintError, Origin
from keymint_ros2_dds.enclave_layout import GOVERNANCE, GOVERNANCE_XML
from keymint_ros2_dds.reading import dialects
from keymint_ros2_dds.reading.dialects import PLAIN, REFUSES, UNMODELLED, Quirk
from keymint_ros2_dds.reading.signed_permissions import DocumentDomains, defects_in_file, document_domains, raw_text

ACCESS = {"publish": "enable_write_access_control", "subscribe": "enable_read_access_control"}
"""The element that puts an action under access control."""
JOIN, UNAUTHENTICATED = "enable_join_access_control", "allow_unauthenticated_participants"
DOMAIN_PROTECTIONS = ("discovery_protection_kind", "liveliness_protection_kind", "rtps_protection_kind")
TOPIC_PROTECTIONS = (
    "enable_discovery_protection", "enable_liveliness_protection", "metadata_protection_kind", "data_protection_kind",
)  # fmt: skip
_BOOLEANS = {"true": True, "1": True, "false": False, "0": False}
_BLANKS = " \t\r\n"
_NOWHERE = DocumentDomains(None, None)
"""What is read of text that is no domain id; the schema refuses it."""


class DocumentTopicRule(Data):
    """How the topics that an expression matches are protected.

    Attributes:
        expression: as it is written.
        read_controlled: subscribing is subject to permissions.
        write_controlled: publishing is subject to permissions.
        protections: the text of the elements of :data:`TOPIC_PROTECTIONS`, in this order.
        line: line of the element.
    """

    expression: str
    read_controlled: bool
    write_controlled: bool
    protections: tuple[str, ...]
    line: int

    @property
    def controlled(self) -> bool:
        """Whether permissions are checked for both actions."""
        return self.read_controlled and self.write_controlled

    def controls(self, action: str) -> bool:
        """Tell whether permissions are checked for ``publish`` or ``subscribe``."""
        return self.write_controlled if action == "publish" else self.read_controlled


class DocumentDomainRule(Data):
    """How some domains are protected.

    Attributes:
        domains: the domains.
        join_controlled: a participant needs a rule of its permissions to join.
        unauthenticated: participants without identity and permissions may join.
        protections: the text of the elements of :data:`DOMAIN_PROTECTIONS`, in this order.
        topic_rules: in the order of the document.
        line: line of the element.
        lines: the lines of its simple elements, by tag.
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
        return not self.join_controlled or self.opens

    @property
    def opens(self) -> bool:
        """Whether some topic is not under access control."""
        return not all(rule.controlled for rule in self.topic_rules)

    def line_of(self, tag: str) -> int:
        """Return the line of an element, or of the rule if there is no such element."""
        return dict(self.lines).get(tag, self.line)


class GovernanceDocument(Data):
    """A governance document.

    Attributes:
        file: its name, for people.
        domain_rules: in the order of the document.
        defects: how it violates the schema.
        quirks: what may make vendors read it differently from a plain document, by line.
        offset: number of lines of the file before the document.
    """

    file: str
    domain_rules: tuple[DocumentDomainRule, ...]
    defects: tuple[Diagnostic, ...]
    quirks: tuple[Quirk, ...]
    offset: int = 0

    @property
    def defect(self) -> str:
        """Why the schema refuses it, or an empty text."""
        return f"{self.defects[0].where}: the schema refuses it: {self.defects[0].message}" if self.defects else ""

    def place(self, line: int) -> Origin:
        """Return a line of the document as a place in its file."""
        return Origin(self.file, line + self.offset)

    def rule(self, domain: int, *, min_only_is_exact: bool = False) -> DocumentDomainRule | None:
        """Return the rule that applies in a domain, or None.

        Args:
            domain: DDS domain id.
            min_only_is_exact: a range that has only a minimum is that one domain.
        """
        for rule in self.domain_rules:
            if any(domains.contain(domain, min_only_is_exact=min_only_is_exact) for domains in rule.domains):
                return rule
        return None


def read(content: bytes, file: str = GOVERNANCE_XML, offset: int = 0) -> GovernanceDocument:
    """Read a governance document.

    Args:
        content: XML, unsigned.
        file: its name, for people.
        offset: number of lines of the file before the document.

    Raises:
        KeymintError: it is not well-formed, or not a governance document.
    """
    try:
        found = _read(content)
    except KeymintError as error:
        raise KeymintError.of(defects_in_file(error.diagnostics, file, offset)) from None
    return replace(found, file=file, offset=offset, defects=defects_in_file(found.defects, file, offset))


# Enclaves usually have the same governance.
@lru_cache(maxsize=64)
def _read(content: bytes) -> GovernanceDocument:
    root = parse(content, GOVERNANCE_XML, limits=dialects.DOCUMENT_LIMITS)
    if root.tag != "dds" or root.find("domain_access_rules") is None:
        where = Origin(GOVERNANCE_XML, line(root))
        raise KeymintError("this is not a governance document", where=where, code="document-kind")
    defects, document_quirks = dialects.quirks_by_schema(root, GOVERNANCE, GOVERNANCE_XML, _quirks(content, root))
    rules = tuple(map(_domain_rule, root.iterfind("domain_access_rules/domain_rule")))
    return GovernanceDocument(GOVERNANCE_XML, rules, defects, document_quirks)


def _domain_rule(element: etree._Element) -> DocumentDomainRule:
    return DocumentDomainRule(
        tuple(each for each in document_domains(element.find("domains"), _number) if each != _NOWHERE),
        _is_true(element, JOIN),
        _is_true(element, UNAUTHENTICATED, otherwise=False),
        tuple(_text(element.find(tag)) for tag in DOMAIN_PROTECTIONS),
        tuple(map(_topic_rule, element.iterfind("topic_access_rules/topic_rule"))),
        line(element),
        tuple((str(child.tag), line(child)) for child in element if not len(child)),
    )


def _topic_rule(element: etree._Element) -> DocumentTopicRule:
    return DocumentTopicRule(
        raw_text(element.find("topic_expression")),
        _is_true(element, ACCESS["subscribe"]),
        _is_true(element, ACCESS["publish"]),
        tuple(_text(element.find(tag)) for tag in TOPIC_PROTECTIONS),
        line(element),
    )


def _number(element: etree._Element | None) -> int | None:
    text = _text(element)
    return int(text) if dialects.is_number(text.removeprefix("+")) else None


def _text(element: etree._Element | None) -> str:
    return raw_text(element).strip(_BLANKS)


def _is_true(element: etree._Element, tag: str, *, otherwise: bool = True) -> bool:
    """Return a boolean; a document in which it is missing or invalid is refused by the schema."""
    return _BOOLEANS.get(_text(element.find(tag)), otherwise)


def _quirks(content: bytes, root: etree._Element) -> Iterator[Quirk]:
    """Yield the quirks of a document that its schema allows."""
    inner_end = max(content.find(b"</domain_access_rules>"), 0)  # Fast DDS refuses a comment after it
    for quirk in dialects.quirks_of_bytes(content, comments_until=inner_end):
        yield Quirk(quirk.line, quirk.text, UNMODELLED, UNMODELLED)
    yield from dialects.quirks_of_domain_ids(root)
    for element in root.iter():
        text = raw_text(element)
        if len(element):
            continue
        if text != text.strip(_BLANKS):
            yield Quirk(line(element), f"white space around the text of <{element.tag}>", UNMODELLED, UNMODELLED)
        elif "\n" in text or "\r" in text:
            yield Quirk(line(element), f"a line end within the text of <{element.tag}>", UNMODELLED, UNMODELLED)
    for element in root.iter("id_range"):
        first, last = (_number(element.find(tag)) for tag in ("min", "max"))
        if element.find("min") is None or (first is not None and last is not None and last < first):
            yield Quirk(line(element), "a range of domains without a minimum, or not in order", REFUSES, PLAIN)
