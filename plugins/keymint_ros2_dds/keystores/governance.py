# SPDX-License-Identifier: Apache-2.0
"""Write a signed governance document as the source that a profile has: ``package.defaults/governance.xml``."""

from __future__ import annotations

from lxml import etree

from keymint_ros2_dds.documents import dds_xml
from keymint_ros2_dds.reading import signed_governance
from keymint_ros2_dds.reading.signed_governance import (
    DOMAIN_PROTECTIONS,
    JOIN,
    UNAUTHENTICATED,
    DocumentDomainRule,
    DocumentTopicRule,
    GovernanceDocument,
)
from keymint_ros2_dds.reading.signed_permissions import as_ranges

_HEAD = (
    b'<?xml version="1.0" encoding="UTF-8"?>\n'
    b"<!-- Defaults of each domain rule of a package's governance.xml, as they were found in the keystore that was\n"
    b"     taken over. All participants of a domain need the same values. -->\n"
)


def source(document: bytes, signer: str) -> bytes | None:
    """Return the source of a governance document; None if it has several domain rules, which defaults cannot have.

    Args:
        document: the signed document.
        signer: name of the authority that signs it.
    """
    rules = signed_governance.read(document).domain_rules
    if len(rules) != 1:
        return None
    rule = rules[0]
    root = etree.Element("defaults")
    dds_xml.child(root, "issuer_name", signer)
    dds_xml.domains(root, as_ranges(rule.domains))
    dds_xml.child(root, UNAUTHENTICATED, _boolean(rule.unauthenticated))
    dds_xml.child(root, JOIN, _boolean(rule.join_controlled))
    for tag, kind in zip(DOMAIN_PROTECTIONS, rule.protections, strict=True):
        dds_xml.child(root, tag, kind)
    topics = dds_xml.child(root, "topic_access_rules")
    for topic in rule.topic_rules:
        _topic_rule(topics, topic)
    etree.indent(root)
    return _HEAD + etree.tostring(root, encoding="unicode").encode() + b"\n"


def _topic_rule(parent: etree._Element, rule: DocumentTopicRule) -> None:
    discovery, liveliness, metadata, data = rule.protections
    element = dds_xml.child(parent, "topic_rule")
    dds_xml.child(element, "topic_expression", rule.expression)
    dds_xml.child(element, "enable_discovery_protection", discovery)
    dds_xml.child(element, "enable_liveliness_protection", liveliness)
    dds_xml.child(element, "enable_read_access_control", _boolean(rule.read_controlled))
    dds_xml.child(element, "enable_write_access_control", _boolean(rule.write_controlled))
    dds_xml.child(element, "metadata_protection_kind", metadata)
    dds_xml.child(element, "data_protection_kind", data)


def is_same(one: bytes, other: bytes) -> bool:
    """Tell whether two governance documents have the same rules in the same order, however they are written."""
    return _meaning(signed_governance.read(one)) == _meaning(signed_governance.read(other))


def _meaning(document: GovernanceDocument) -> list[tuple[object, ...]]:
    return [_domain_rule(rule) for rule in document.domain_rules]


def _domain_rule(rule: DocumentDomainRule) -> tuple[object, ...]:
    topics = [
        (each.expression.strip(), each.read_controlled, each.write_controlled, *map(_value, each.protections))
        for each in rule.topic_rules
    ]
    return (rule.domains, rule.join_controlled, rule.unauthenticated, rule.protections, tuple(topics))


def _value(text: str) -> str:
    """Return a boolean of XML Schema in one form, and other text as it is."""
    return {"1": "true", "0": "false"}.get(text, text)


def _boolean(value: bool) -> str:
    return "true" if value else "false"
