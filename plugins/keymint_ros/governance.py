"""Governance: how domains and topics are protected, from a package's document and its defaults."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

from comarmor.errors import Origin
from keymint.api import DomainRange, DomainRule, TopicProtection
from keymint.errors import KeymintError
from keymint_ros.document import Reader, line, place, text, truth

if TYPE_CHECKING:
    from lxml import etree

_T = TypeVar("_T")


@dataclass(frozen=True, slots=True)
class TopicRule:
    """What a document says of the protection of topics; None for what it leaves out."""

    line: int
    kind: str
    expression: str
    discovery: bool | None
    liveliness: bool | None
    read: bool | None
    write: bool | None
    metadata: str | None
    data: str | None


@dataclass(frozen=True, slots=True)
class Written:
    """What a document says of a domain; None for what it leaves out."""

    line: int
    issuer: str | None = None
    domains: tuple[DomainRange, ...] | None = None
    allow_unauthenticated: bool | None = None
    join_access_control: bool | None = None
    discovery: str | None = None
    liveliness: str | None = None
    rtps: str | None = None
    topic_rules: tuple[TopicRule, ...] = ()


STRICT = Written(
    line=0,
    domains=(DomainRange(0, 0),),
    allow_unauthenticated=False,
    join_access_control=True,
    discovery="ENCRYPT",
    liveliness="ENCRYPT",
    rtps="SIGN",
)
"""What is neither in a package's document nor in its defaults."""
_STRICT_TOPIC = TopicRule(
    0, "topic", "*", discovery=True, liveliness=True, read=True, write=True, metadata="ENCRYPT", data="ENCRYPT"
)


def domains(element: etree._Element | None) -> tuple[DomainRange, ...] | None:
    """Return the domains that a ``<domains>`` element lists, or None when there is no element.

    Raises:
        KeymintError: a range ends before it begins.
    """
    if element is None:
        return None
    found = []
    for item in element:
        ends = [int(text(end) or "") for end in item] or [int(text(item) or "")]
        if ends[0] > ends[-1]:
            raise KeymintError(
                f"the range of domains ends at {ends[-1]}, before its start at {ends[0]}",
                where=place(item),
                help="exchange <min> and <max>",
                code="domain-range",
            )
        found.append(DomainRange(ends[0], ends[-1]))
    return tuple(dict.fromkeys(found))


def _domain(element: etree._Element) -> Written:
    rules = element.find("topic_access_rules")
    return Written(
        line=line(element),
        issuer=text(element.find("issuer_name")),
        domains=domains(element.find("domains")),
        allow_unauthenticated=truth(element.find("allow_unauthenticated_participants")),
        join_access_control=truth(element.find("enable_join_access_control")),
        discovery=text(element.find("discovery_protection_kind")),
        liveliness=text(element.find("liveliness_protection_kind")),
        rtps=text(element.find("rtps_protection_kind")),
        topic_rules=() if rules is None else tuple(_topic_rule(rule) for rule in rules),
    )


def _topic_rule(element: etree._Element) -> TopicRule:
    said = {part.tag: part for part in element}
    kind = str(element.tag).removesuffix("_rule")
    return TopicRule(
        line=line(element),
        kind=kind,
        expression=text(said[f"{kind.removeprefix('ros_')}_expression"]) or "",
        discovery=truth(said.get("enable_discovery_protection")),
        liveliness=truth(said.get("enable_liveliness_protection")),
        read=truth(said.get("enable_read_access_control")),
        write=truth(said.get("enable_write_access_control")),
        metadata=text(said.get("metadata_protection_kind")),
        data=text(said.get("data_protection_kind")),
    )


def _document(root: etree._Element) -> tuple[Written, ...]:
    return tuple(_domain(rule) for rule in root.iterfind("domain_access_rules/domain_rule"))


read = Reader("governance", _document)
"""Reads a package's document: its domain rules in order."""
read_defaults = Reader("defaults_governance", _domain)
"""Reads the defaults of a domain rule."""


def complete(own: Iterable[Written], file: str, defaults: Written, defaults_file: str) -> tuple[DomainRule, ...]:
    """Return the domain rules that a package and its defaults ask for together.

    A domain rule's own topic rules come first, then those of the defaults, since the first that matches a topic
    decides. What a topic rule leaves out is that of the defaults' rule for every topic.

    Args:
        own: the domain rules of the package; when there is none, the defaults are the only one.
        file: its document, for origins.
        defaults: says what they leave out.
        defaults_file: its document, for origins.
    """
    general = next((rule for rule in defaults.topic_rules if (rule.kind, rule.expression) == ("topic", "*")), None)
    inherited = tuple(_protection(rule, general, defaults_file) for rule in defaults.topic_rules)
    rules = [
        _domain_rule(
            rule,
            defaults,
            tuple(_protection(one, general, file) for one in rule.topic_rules) + inherited,
            Origin(file, rule.line),
            None if rule.domains else Origin(defaults_file, defaults.line),
        )
        for rule in own
    ]
    return tuple(rules) or (_domain_rule(defaults, defaults, inherited, Origin(defaults_file, defaults.line)),)


def _domain_rule(
    said: Written, other: Written, topics: tuple[TopicProtection, ...], origin: Origin, domains: Origin | None = None
) -> DomainRule:
    return DomainRule(
        domains=_first(said.domains, other.domains, STRICT.domains),
        allow_unauthenticated_participants=_first(
            said.allow_unauthenticated, other.allow_unauthenticated, STRICT.allow_unauthenticated
        ),
        enable_join_access_control=_first(
            said.join_access_control, other.join_access_control, STRICT.join_access_control
        ),
        discovery_protection_kind=_first(said.discovery, other.discovery, STRICT.discovery),
        liveliness_protection_kind=_first(said.liveliness, other.liveliness, STRICT.liveliness),
        rtps_protection_kind=_first(said.rtps, other.rtps, STRICT.rtps),
        topic_rules=topics,
        origin=origin,
        domains_origin=domains,
    )


def _protection(said: TopicRule, general: TopicRule | None, file: str) -> TopicProtection:
    other, strict = general or _STRICT_TOPIC, _STRICT_TOPIC
    return TopicProtection(
        kind=said.kind,
        expression=said.expression,
        enable_discovery_protection=_first(said.discovery, other.discovery, strict.discovery),
        enable_liveliness_protection=_first(said.liveliness, other.liveliness, strict.liveliness),
        enable_read_access_control=_first(said.read, other.read, strict.read),
        enable_write_access_control=_first(said.write, other.write, strict.write),
        metadata_protection_kind=_first(said.metadata, other.metadata, strict.metadata),
        data_protection_kind=_first(said.data, other.data, strict.data),
        origin=Origin(file, said.line),
    )


def _first(*values: _T | None) -> _T:
    return next(value for value in values if value is not None)
