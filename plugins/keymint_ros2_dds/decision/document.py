"""A permissions document as it is signed, read into data types that know their lines.

Read is more than the schema allows, since vendors accept more; :attr:`PermissionsDocument.defects` says what the
schema has against it (DDS Security 1.1, 9.4.1.3).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from lxml import etree

from comarmor import schema
from comarmor.errors import ComArmorError
from comarmor.reader import line, parse
from keymint.errors import Diagnostic, KeymintError, Origin, Severity

ACTIONS = ("publish", "subscribe", "relay")


@dataclass(frozen=True, slots=True)
class Domains:
    """Domain ids from ``first`` to ``last``; None where the document leaves an end of the range open."""

    first: int | None
    last: int | None


@dataclass(frozen=True, slots=True)
class Criteria:
    """One ``<publish>``, ``<subscribe>`` or ``<relay>`` of a rule.

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
class Rule:
    """An ``<allow_rule>`` or a ``<deny_rule>``."""

    allows: bool
    domains: tuple[Domains, ...]
    criteria: tuple[Criteria, ...]
    line: int


@dataclass(frozen=True, slots=True)
class Grant:
    """The rights of a subject, for a time.

    Attributes:
        name: its name attribute, or None.
        subject_name: text, with the white space around it.
        not_before: text.
        not_after: text.
        rules: in the order of the document.
        default: ``ALLOW`` or ``DENY``, or None when it is missing.
        rules_end: the default is the last element, as the schema wants it.
        line: line of the element.
    """

    name: str | None
    subject_name: str
    not_before: str
    not_after: str
    rules: tuple[Rule, ...]
    default: str | None
    rules_end: bool
    line: int


@dataclass(frozen=True, slots=True)
class PermissionsDocument:
    """A permissions document.

    Attributes:
        file: its name, for people.
        grants: in the order of the document.
        defects: what the schema has against it.
    """

    file: str
    grants: tuple[Grant, ...]
    defects: tuple[Diagnostic, ...]


def read(content: bytes, file: str = "permissions.xml") -> PermissionsDocument:
    """Read a permissions document.

    Args:
        content: XML, unsigned.
        file: its name, for people.

    Raises:
        KeymintError: it is not well-formed, not a permissions document, or a number in it is none.
    """
    try:
        root = parse(content, file)
    except ComArmorError as error:
        raise KeymintError.of(_diagnostics(error, file)) from None
    if root.tag != "dds" or root.find("permissions") is None:
        raise KeymintError("this is not a permissions document", where=Origin(file, line(root)), code="document-kind")
    grants = tuple(_grant(item, file) for item in root.iterfind("permissions/grant"))
    return PermissionsDocument(file, grants, _defects(root, file))


def _defects(root: etree._Element, file: str) -> tuple[Diagnostic, ...]:
    try:
        schema.validate(root, "dds/permissions.xsd", file)
    except ComArmorError as error:
        return _diagnostics(error, file)
    return ()


def _diagnostics(error: ComArmorError, file: str) -> tuple[Diagnostic, ...]:
    return tuple(
        Diagnostic(
            item.code,
            Severity.ERROR,
            item.message,
            Origin(item.where.file, item.where.line) if item.where else Origin(file),
            item.help,
        )
        for item in error.diagnostics
    )


def _grant(element: etree._Element, file: str) -> Grant:
    children = [child for child in element if isinstance(child.tag, str)]
    default = element.find("default")
    return Grant(
        element.get("name"),
        element.findtext("subject_name") or "",
        element.findtext("validity/not_before") or "",
        element.findtext("validity/not_after") or "",
        tuple(_rule(child, file) for child in children if child.tag in {"allow_rule", "deny_rule"}),
        None if default is None else (default.text or "").strip(),
        default is None or children[-1] is default,
        line(element),
    )


def _rule(element: etree._Element, file: str) -> Rule:
    domains = element.find("domains")
    return Rule(
        element.tag == "allow_rule",
        () if domains is None else tuple(_domains(domains, file)),
        tuple(_criteria(child) for child in element if child.tag in ACTIONS),
        line(element),
    )


def _domains(element: etree._Element, file: str) -> Iterator[Domains]:
    for child in element:
        if child.tag == "id":
            number = _number(child, file)
            yield Domains(number, number)
        elif child.tag == "id_range":
            low, high = child.find("min"), child.find("max")
            yield Domains(
                None if low is None else _number(low, file),
                None if high is None else _number(high, file),
            )


def _number(element: etree._Element, file: str) -> int:
    text = (element.text or "").strip()
    if not (text.isascii() and text.isdigit()):
        raise KeymintError(
            f"{text!r} is no domain id, expected a whole number", where=Origin(file, line(element)), code="domains"
        )
    return int(text)


def _criteria(element: etree._Element) -> Criteria:
    partitions, tags = element.find("partitions"), element.find("data_tags")
    return Criteria(
        str(element.tag),
        tuple(topic.text or "" for topic in element.iterfind("topics/topic")),
        None if partitions is None else tuple(item.text or "" for item in partitions.iterfind("partition")),
        None
        if tags is None
        else tuple((tag.findtext("name") or "", tag.findtext("value") or "") for tag in tags.iterfind("tag")),
        line(element),
    )
