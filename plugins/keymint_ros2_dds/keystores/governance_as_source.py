# SPDX-License-Identifier: Apache-2.0
"""Write a signed governance document as the source that a profile has: ``package.defaults/governance.xml``."""

from __future__ import annotations

from lxml import etree

from keymint_ros2_dds.documents import dds_xml
from keymint_ros2_dds.reading import signed_governance
from keymint_ros2_dds.reading.signed_governance import (
    ACCESS,
    DOMAIN_PROTECTIONS,
    JOIN,
    TOPIC_PROTECTIONS,
    UNAUTHENTICATED,
    DocumentDomainRule,
    DocumentTopicRule,
)
from keymint_ros2_dds.reading.signed_permissions import as_ranges
from keymint_ros2_dds.settings import STRICT_TOPIC

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
    dds_xml.settings(root, {UNAUTHENTICATED: rule.unauthenticated, JOIN: rule.join_controlled})
    dds_xml.settings(root, dict(zip(DOMAIN_PROTECTIONS, rule.protections, strict=True)))
    topics = dds_xml.child(root, "topic_access_rules")
    for topic in rule.topic_rules:
        _topic_rule(topics, topic)
    etree.indent(root)
    return _HEAD + etree.tostring(root, encoding="unicode").encode() + b"\n"


def _topic_rule(parent: etree._Element, rule: DocumentTopicRule) -> None:
    own: dict[str, str | bool] = {
        **dict(zip(TOPIC_PROTECTIONS, rule.protections, strict=True)),
        ACCESS["subscribe"]: rule.read_controlled,
        ACCESS["publish"]: rule.write_controlled,
    }
    dds_xml.topic_rule(parent, rule.expression, {name: own[name] for name in STRICT_TOPIC})


def is_same(one: bytes, other: bytes) -> bool:
    """Tell whether two governance documents have the same rules in the same order, however they are written."""
    first, second = ([_meaning(rule) for rule in signed_governance.read(each).domain_rules] for each in (one, other))
    return first == second


def _meaning(rule: DocumentDomainRule) -> tuple[object, ...]:
    topics = [
        (each.expression.strip(), each.read_controlled, each.write_controlled, *map(_value, each.protections))
        for each in rule.topic_rules
    ]
    return (rule.domains, rule.join_controlled, rule.unauthenticated, rule.protections, tuple(topics))


def _value(text: str) -> str:
    """Return a boolean of XML Schema in one form, and other text as it is."""
    return {"1": "true", "0": "false"}.get(text, text)
