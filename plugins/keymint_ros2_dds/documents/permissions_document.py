"""The permissions document: a grant for one subject (DDS Security 1.1, 9.4.1.3)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from xml.sax.saxutils import escape

from lxml import etree

from comarmor.errors import Diagnostic, Severity
from comarmor.rules import Effect
from keymint.api import Permissions
from keymint.errors import KeymintError
from keymint.pki import names
from keymint_ros2_dds.compiling.criteria import Criteria
from keymint_ros2_dds.compiling.partitions import DEFAULT
from keymint_ros2_dds.documents import dds_xml
from keymint_ros2_dds.domains import check_domains, merged
from keymint_ros2_dds.layout import PERMISSIONS
from keymint_ros2_dds.lowering.lower import Partitions
from keymint_ros2_dds.lowering.mapping import Action


def render(permissions: Permissions, rules: Iterable[Criteria]) -> bytes:
    """Return the permissions document, valid against its schema; a pure function of its arguments.

    Raises:
        KeymintError: the subject's name, a date or a domain cannot be said alike for all vendors.
    """
    subject = permissions.rules.subject
    problems = check_domains(permissions.domains, permissions.domains_origin or permissions.origin, subject)
    if permissions.validity.not_after.year > dds_xml.MAX_YEAR:
        message = (
            f"the permissions end in the year {permissions.validity.not_after.year}, which Cyclone DDS takes to be over"
        )
        help_ = f"let them end by {dds_xml.MAX_YEAR}"
        problems.append(Diagnostic("portability-date", Severity.ERROR, message, permissions.origin, help_, subject))
    if problems:
        raise KeymintError.of(problems)
    root = dds_xml.root(PERMISSIONS)
    grant = dds_xml.child(dds_xml.child(root, "permissions"), "grant")
    grant.set("name", permissions.grant_name)
    dds_xml.child(grant, "subject_name", names.render(names.parse(permissions.subject_name, permissions.origin)))
    validity = dds_xml.child(grant, "validity")
    dds_xml.child(validity, "not_before", dds_xml.date(permissions.validity.not_before))
    dds_xml.child(validity, "not_after", dds_xml.date(permissions.validity.not_after))
    for rule in rules:
        element = dds_xml.child(grant, "allow_rule" if rule.effect is Effect.ALLOW else "deny_rule")
        dds_xml.domains(element, permissions.domains)
        for action, texts in rule.topics.items():
            _criteria(element, action, texts, rule.partitions)
    dds_xml.child(grant, "default", "DENY")
    return dds_xml.render(root, PERMISSIONS)


def _criteria(parent: etree._Element, action: Action, texts: Iterable[str], listed: Partitions) -> None:
    element = dds_xml.child(parent, action)
    topics = dds_xml.child(element, "topics")
    for text in texts:
        dds_xml.child(topics, "topic", text)
    if listed != DEFAULT:
        names_ = dds_xml.child(element, "partitions")
        for text in listed:
            dds_xml.child(names_, "partition", text)


def rendered_size(permissions: Permissions, rules: Iterable[Criteria]) -> int:
    """Return how many bytes :func:`render` would return, without rendering the rules.

    Raises:
        KeymintError: as :func:`render` does.
    """
    frame = render(permissions, ()).splitlines(keepends=True)
    bare = _Size(sum(len(line.lstrip(b" ")) for line in frame), 0)
    whole = bare + _Size(0, sum(map(len, frame)) - bare.text) + _rules_size(permissions, rules)
    indented = whole.text + whole.blanks
    return indented if indented <= dds_xml.INDENTED else whole.text


@dataclass(frozen=True, slots=True)
class _Size:
    """Bytes of lines: what they say, and the blanks that they begin with where a document is indented."""

    text: int
    blanks: int

    def __add__(self, other: _Size) -> _Size:
        return _Size(self.text + other.text, self.blanks + other.blanks)


def _rules_size(permissions: Permissions, rules: Iterable[Criteria]) -> _Size:
    ranges = merged(permissions.domains)
    same = {"id": [str(each.first) for each in ranges if each.first == each.last]}
    domains = _lines(same, 5)
    for each in ranges:
        if each.first != each.last:
            domains += _around("id_range", 5, _lines({"min": [str(each.first)], "max": [str(each.last)]}, 6))
    domains = _around("domains", 4, domains)
    total = _Size(0, 0)
    for rule in rules:
        tag = "allow_rule" if rule.effect is Effect.ALLOW else "deny_rule"
        total += _around(tag, 3, domains + _criteria_size(rule))
    return total


def _criteria_size(rule: Criteria) -> _Size:
    listed = _Size(0, 0)
    if rule.partitions != DEFAULT:
        listed = _around("partitions", 5, _lines({"partition": rule.partitions}, 6))
    total = _Size(0, 0)
    for action, texts in rule.topics.items():
        total += _around(action, 4, _around("topics", 5, _lines({"topic": texts}, 6)) + listed)
    return total


def _around(tag: str, depth: int, inner: _Size) -> _Size:
    """Return the size of an element that has others, a line each, in it."""
    return inner + _Size(2 * len(tag) + len("<>\n</>\n"), 2 * 2 * depth)


def _lines(texts: Mapping[str, Sequence[str]], depth: int) -> _Size:
    """Return the size of elements with a text, a line each, by tag."""
    sizes = [
        len(escape(text).encode()) + 2 * len(tag) + len("<></>\n") for tag, listed in texts.items() for text in listed
    ]
    return _Size(sum(sizes), 2 * depth * len(sizes))
