# SPDX-License-Identifier: Apache-2.0
"""Governance: the protection of domains and topics, from a package's document and its defaults."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from comarmor.errors import Origin
from comarmor.xml.reader import line
from keymint.api import DomainRange, DomainRule, TopicProtection
from keymint.errors import KeymintError
from keymint_ros.document import Reader, place, text

if TYPE_CHECKING:
    from lxml import etree

DEFAULT_DOMAINS = (DomainRange(0, 0),)
"""The domains where neither a package's document nor its defaults name any."""
_STRICT_DOMAIN: Mapping[str, Any] = {
    "allow_unauthenticated_participants": False,
    "enable_join_access_control": True,
    "discovery_protection_kind": "ENCRYPT",
    "liveliness_protection_kind": "ENCRYPT",
    "rtps_protection_kind": "SIGN",
}
"""Settings of a domain rule where neither a package's document nor its defaults give them."""
_STRICT_TOPIC: Mapping[str, Any] = {
    "enable_discovery_protection": True,
    "enable_liveliness_protection": True,
    "enable_read_access_control": True,
    "enable_write_access_control": True,
    "metadata_protection_kind": "ENCRYPT",
    "data_protection_kind": "ENCRYPT",
}
"""The same for a topic rule."""


@dataclass(frozen=True, slots=True)
class TopicRuleElement:
    """A ``<topic_rule>``, ``<ros_service_rule>`` and so on.

    Attributes:
        settings: the settings that it gives, by tag.
    """

    line: int
    kind: str
    expression: str
    settings: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class DomainRuleElement:
    """A ``<domain_rule>``, or the ``<defaults>`` of all.

    Attributes:
        issuer: name of the authority that signs the governance; empty if not given.
        domains: empty if not given.
        settings: the settings that it gives, by tag.
    """

    line: int
    issuer: str
    domains: tuple[DomainRange, ...]
    settings: Mapping[str, Any]
    topic_rules: tuple[TopicRuleElement, ...]


def domains(element: etree._Element | None) -> tuple[DomainRange, ...]:
    """Return the domains that a ``<domains>`` element lists; empty if there is no element.

    Raises:
        KeymintError: a range ends before it begins.
    """
    ranges = []
    for item in () if element is None else element:
        ends = [int(text(end) or "") for end in item] or [int(text(item) or "")]
        if ends[0] > ends[-1]:
            raise KeymintError(
                f"the range of domains ends at {ends[-1]}, before its start at {ends[0]}",
                where=place(item),
                help="exchange <min> and <max>",
                code="domain-range",
            )
        ranges.append(DomainRange(ends[0], ends[-1]))
    return tuple(dict.fromkeys(ranges))


def _domain_rule_element(element: etree._Element) -> DomainRuleElement:
    return DomainRuleElement(
        line=line(element),
        issuer=text(element.find("issuer_name")) or "",
        domains=domains(element.find("domains")),
        settings=_settings(element, _STRICT_DOMAIN),
        topic_rules=tuple(_topic_rule_element(rule) for rule in element.iterfind("topic_access_rules/*")),
    )


def _topic_rule_element(element: etree._Element) -> TopicRuleElement:
    kind = str(element.tag).removesuffix("_rule")
    expression = element.find(f"{kind.removeprefix('ros_')}_expression")
    return TopicRuleElement(line(element), kind, text(expression) or "", _settings(element, _STRICT_TOPIC))


def _settings(element: etree._Element, known: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the settings that an element gives: kinds of protection as text, others as booleans."""
    return {
        str(part.tag): text(part) if str(part.tag).endswith("_kind") else text(part) in {"true", "1"}
        for part in element
        if part.tag in known
    }


read = Reader(
    "governance",
    lambda root: tuple(_domain_rule_element(rule) for rule in root.iterfind("domain_access_rules/domain_rule")),
)
"""Reads the domain rules of a package, in order."""
read_defaults = Reader("defaults_governance", _domain_rule_element)
"""Reads the defaults of a domain rule."""


def complete(
    own: Iterable[DomainRuleElement], file: str, defaults: DomainRuleElement, defaults_file: str
) -> tuple[DomainRule, ...]:
    """Return the domain rules that a package and its defaults describe together.

    A domain rule's own topic rules come before those of the defaults, since the first one that matches a topic decides.
    A topic rule takes the settings that it leaves out from the defaults' rule for every topic.

    Args:
        own: the domain rules of the package. If it has none, the defaults become the only rule.
        file: the package's document, for origins.
        defaults: values for everything that these rules leave out.
        defaults_file: the document of the defaults, for origins.
    """
    general: Mapping[str, Any] = next(
        (rule.settings for rule in defaults.topic_rules if (rule.kind, rule.expression) == ("topic", "*")), {}
    )
    base = DomainRule(
        domains=defaults.domains or DEFAULT_DOMAINS,
        topic_rules=tuple(_topic_protection(rule, general, defaults_file) for rule in defaults.topic_rules),
        origin=Origin(defaults_file, defaults.line),
        **{**_STRICT_DOMAIN, **defaults.settings},
    )
    rules = tuple(
        replace(
            base,
            domains=rule.domains or base.domains,
            topic_rules=tuple(_topic_protection(topic, general, file) for topic in rule.topic_rules) + base.topic_rules,
            origin=Origin(file, rule.line),
            domains_origin=None if rule.domains else base.origin,
            **rule.settings,
        )
        for rule in own
    )
    return rules or (base,)


def _topic_protection(rule: TopicRuleElement, general: Mapping[str, Any], file: str) -> TopicProtection:
    settings = {**_STRICT_TOPIC, **general, **rule.settings}
    return TopicProtection(rule.kind, rule.expression, origin=Origin(file, rule.line), **settings)
