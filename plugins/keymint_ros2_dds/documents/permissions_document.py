# SPDX-License-Identifier: Apache-2.0
"""Writes the permissions document: a grant for one subject (DDS Security 1.1, 9.4.1.3)."""

from __future__ import annotations

from collections.abc import Iterable

from lxml import etree

from comarmor.errors import Diagnostic, Severity
from comarmor.rules import Effect
from keymint.api import Grant
from keymint.errors import KeymintError
from keymint.pki import distinguished_names
from keymint_ros2_dds import subject_name_text
from keymint_ros2_dds.documents import dds_xml
from keymint_ros2_dds.domains import check_domains
from keymint_ros2_dds.enclave_layout import PERMISSIONS
from keymint_ros2_dds.lowering.grant_rules import DEFAULT, GrantRule
from keymint_ros2_dds.settings import validity_of

_MAX_YEAR = 2261
"""Cyclone DDS counts time in nanoseconds of 64 bits, and reads later years as expired."""


def document_tree(permissions: Grant, rules: Iterable[GrantRule[str]]) -> etree._Element:
    """Return the root element of the permissions document; a pure function of its arguments.

    Raises:
        KeymintError: the subject's name, a date or a domain cannot be expressed portably across DDS vendors.
    """
    subject = permissions.rules.subject
    period = validity_of(permissions)
    problems = check_domains(permissions.domains, permissions.domains_origin or permissions.origin, subject)
    if period.not_after.year > _MAX_YEAR:
        message = f"the permissions end in the year {period.not_after.year}, which Cyclone DDS reads as expired"
        help_ = f"let them end by {_MAX_YEAR}"
        problems.append(Diagnostic("portability-date", Severity.ERROR, message, permissions.origin, help_, subject))
    if problems:
        raise KeymintError.of(problems)
    root = dds_xml.root(PERMISSIONS)
    grant = dds_xml.child(dds_xml.child(root, "permissions"), "grant")
    grant.set("name", permissions.name)
    dds_xml.child(
        grant,
        "subject_name",
        subject_name_text.render(distinguished_names.parse(permissions.subject_name, permissions.origin)),
    )
    validity = dds_xml.child(grant, "validity")
    dds_xml.child(validity, "not_before", dds_xml.date(period.not_before))
    dds_xml.child(validity, "not_after", dds_xml.date(period.not_after))
    for rule in rules:
        _add_rule(grant, permissions, rule)
    dds_xml.child(grant, "default", "DENY")
    return root


def _add_rule(grant: etree._Element, permissions: Grant, rule: GrantRule[str]) -> None:
    element = dds_xml.child(grant, "allow_rule" if rule.effect is Effect.ALLOW else "deny_rule")
    dds_xml.domains(element, permissions.domains)
    for action, expressions in rule.topics.items():
        criteria = dds_xml.child(element, action)
        topics = dds_xml.child(criteria, "topics")
        for expression in expressions:
            dds_xml.child(topics, "topic", expression)
        if rule.partitions != DEFAULT:
            partitions = dds_xml.child(criteria, "partitions")
            for partition in rule.partitions:
                dds_xml.child(partitions, "partition", partition)
