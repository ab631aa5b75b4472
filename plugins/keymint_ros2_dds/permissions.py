"""The permissions document: a grant for one subject (DDS Security 1.1, 9.4.1.3)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from xml.sax.saxutils import escape

from lxml import etree

from keymint.api import Permissions
from keymint.errors import Diagnostic, KeymintError, Severity
from keymint.ir import Effect
from keymint.pki import names
from keymint_ros2_dds import document
from keymint_ros2_dds.compiling.criteria import Criteria
from keymint_ros2_dds.compiling.lower import Partitions
from keymint_ros2_dds.compiling.partitions import DEFAULT
from keymint_ros2_dds.mapping import Action


def render(permissions: Permissions, rules: Iterable[Criteria]) -> bytes:
    """Return the permissions document, valid against its schema; a pure function of its arguments.

    Raises:
        KeymintError: the subject's name, a date or a domain cannot be said alike for all vendors.
    """
    subject = permissions.rules.subject
    problems = document.check_domains(permissions.domains, permissions.domains_origin or permissions.origin, subject)
    if permissions.validity.not_after.year > document.MAX_YEAR:
        message = (
            f"the permissions end in the year {permissions.validity.not_after.year}, which Cyclone DDS takes to be over"
        )
        help_ = f"let them end by {document.MAX_YEAR}"
        problems.append(Diagnostic("portability-date", Severity.ERROR, message, permissions.origin, help_, subject))
    if problems:
        raise KeymintError.of(problems)
    root = document.root(document.PERMISSIONS)
    grant = document.child(document.child(root, "permissions"), "grant")
    grant.set("name", permissions.grant_name)
    document.child(grant, "subject_name", names.render(names.parse(permissions.subject_name, permissions.origin)))
    validity = document.child(grant, "validity")
    document.child(validity, "not_before", document.date(permissions.validity.not_before))
    document.child(validity, "not_after", document.date(permissions.validity.not_after))
    for rule in rules:
        element = document.child(grant, "allow_rule" if rule.effect is Effect.ALLOW else "deny_rule")
        document.domains(element, permissions.domains)
        for action, texts in rule.topics.items():
            _criteria(element, action, texts, rule.partitions)
    document.child(grant, "default", "DENY")
    return document.render(root, document.PERMISSIONS)


def _criteria(parent: etree._Element, action: Action, texts: Iterable[str], listed: Partitions) -> None:
    element = document.child(parent, action)
    topics = document.child(element, "topics")
    for text in texts:
        document.child(topics, "topic", text)
    if listed != DEFAULT:
        names_ = document.child(element, "partitions")
        for text in listed:
            document.child(names_, "partition", text)


def rules_size(permissions: Permissions, rules: Iterable[Criteria]) -> int:
    """Return how many bytes of a rendered document are its rules: what need not be rendered to know its size."""
    ranges = document.merged(permissions.domains)
    same = {"id": [str(each.first) for each in ranges if each.first == each.last]}
    spans = [
        _around("id_range", 5, _lines({"min": [str(each.first)], "max": [str(each.last)]}, 6))
        for each in ranges
        if each.first != each.last
    ]
    domains = _around("domains", 4, _lines(same, 5) + sum(spans))
    return sum(
        _around("allow_rule" if rule.effect is Effect.ALLOW else "deny_rule", 3, domains + _criteria_size(rule))
        for rule in rules
    )


def _criteria_size(rule: Criteria) -> int:
    listed = _around("partitions", 5, _lines({"partition": rule.partitions}, 6)) if rule.partitions != DEFAULT else 0
    return sum(
        _around(action, 4, _around("topics", 5, _lines({"topic": texts}, 6)) + listed)
        for action, texts in rule.topics.items()
    )


def _around(tag: str, depth: int, inner: int) -> int:
    """Return the bytes of an element that has others, a line each, in it."""
    return inner + 2 * (2 * depth + len(tag)) + len("<>\n</>\n")


def _lines(texts: Mapping[str, Sequence[str]], depth: int) -> int:
    """Return the bytes of elements with a text, a line each, by tag."""
    return sum(
        len(escape(text).encode()) + 2 * depth + 2 * len(tag) + len("<></>\n")
        for tag, listed in texts.items()
        for text in listed
    )
