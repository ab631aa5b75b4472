# SPDX-License-Identifier: Apache-2.0
"""Writes the governance document: how domains and topics are protected (DDS Security 1.1, 9.4.1.2)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import lru_cache

from lxml import etree

from comarmor.patterns import glob
from comarmor.patterns.expression import exact
from comarmor.patterns.glob import EVERYTHING, Glob
from comarmor.patterns.relations import covers, union_covers
from comarmor.text import lazy_regex
from comarmor.values import replace
from keymint.api import Package
from keymint.errors import Diagnostic, Severity, require_none
from keymint_ros2_dds.documents import dds_xml
from keymint_ros2_dds.domains import check_domains
from keymint_ros2_dds.enclave_layout import GOVERNANCE
from keymint_ros2_dds.lowering.name_mapping import ARDENT, dds_patterns, needed_topics, parse_expression
from keymint_ros2_dds.lowering.portable_expressions import NotPortableError, portable_expressions
from keymint_ros2_dds.settings import STRICT_DOMAIN, STRICT_TOPIC, DdsSettings, DomainRule, TopicProtection, settings_of

_ODD = lazy_regex(r"[^A-Za-z0-9_/*?\[\]!^\\-]|//|(?<=.)/$")
"""Characters and slashes that no ROS name has; expression syntax aside (ROS 2 design, "Topic and Service Names")."""
_PERMISSIONS = {
    "topic": ("publish",),
    "ros_topic": ("ros_publish",),
    "ros_service": ("ros_call",),
    "ros_action": ("ros_request",),
    "ros_parameter": ("ros_read", "ros_write"),
}
"""A permission of each kind that maps to all of its DDS topics: both sides of a ROS entity use the same ones."""


def build(package: Package, *, allow_vendor_specific: bool) -> tuple[bytes, tuple[Diagnostic, ...]]:
    """Return the governance document, valid against its schema, with warnings and notes.

    Args:
        package: a package with a governance. The document has no partitions, so for Ardent a rule on ROS names applies
            to a base name in every namespace.
        allow_vendor_specific: where vendors differ, follow the standard and warn.

    Raises:
        KeymintError: a rule cannot be expressed portably; each with its place.
    """
    governance = settings_of(package)
    if content := _without_findings(governance, package.distro, allow_vendor_specific):
        return content, ()
    content, diagnostics = _compile(governance, package.distro, allow_vendor_specific)
    diagnostics = tuple(replace(item, subject=package.subject) for item in diagnostics)
    require_none(item for item in diagnostics if item.severity is Severity.ERROR)
    return content, diagnostics


@lru_cache(maxsize=64)
def _without_findings(governance: DdsSettings, distro: str, lenient: bool) -> bytes:
    """Return the document, empty if there is something to report; cached, since most packages have an equal one.

    Where a governance is written does not count when it is compared, so findings, which name places, are not cached.
    """
    content, problems = _compile(governance, distro, lenient)
    return b"" if problems else content


def _compile(governance: DdsSettings, distro: str, lenient: bool) -> tuple[bytes, tuple[Diagnostic, ...]]:
    problems = list(_check(governance, lenient))
    root = dds_xml.root(GOVERNANCE)
    rules = dds_xml.child(root, "domain_access_rules")
    for rule in governance.domain_rules:
        problems += _domain_rule(rules, rule, distro, lenient)
    if any(item.severity is Severity.ERROR for item in problems):
        return b"", tuple(problems)
    return dds_xml.render(root, GOVERNANCE), tuple(problems)


def _check(governance: DdsSettings, lenient: bool) -> Iterator[Diagnostic]:
    for rule in governance.domain_rules:
        yield from check_domains(rule.domains, rule.domains_origin or rule.origin, "")
        if rule.allow_unauthenticated_participants and rule.rtps_protection_kind != "NONE":
            severity, kind = Severity.WARNING if lenient else Severity.ERROR, rule.rtps_protection_kind
            what = f"allow_unauthenticated_participants is true, but rtps_protection_kind is {kind}"
            message = f"{what}: Fast DDS refuses to start"
            help_ = "set rtps_protection_kind to NONE, or do not allow unauthenticated participants"
            yield Diagnostic("portability-unauthenticated", severity, message, rule.origin, help_)


def _domain_rule(parent: etree._Element, rule: DomainRule, distro: str, lenient: bool) -> Iterator[Diagnostic]:
    element = dds_xml.child(parent, "domain_rule")
    dds_xml.domains(element, rule.domains)
    dds_xml.settings(element, {name: getattr(rule, name) for name in STRICT_DOMAIN})
    topics = dds_xml.child(element, "topic_access_rules")
    covered: list[Glob] = []
    for topic in rule.topic_rules:
        topic_patterns = patterns(topic, distro)
        if problem := _never_matches(topic, topic_patterns):
            yield problem
            continue
        effective = [pattern for pattern in topic_patterns if not union_covers(tuple(covered), pattern)]
        if not effective:
            message = (
                f"the {topic.kind} rule for {topic.expression!r} has no effect: the rules before it match all of it"
            )
            help_ = "put it before the wider rules, or remove it"
            yield Diagnostic.warning("governance-shadowed", message, topic.origin, help_)
        if distro == ARDENT and topic.kind != "topic":
            message = (
                f"DDS topics of ROS 2 Ardent have base names only: the {topic.kind} rule for {topic.expression!r} "
                "applies to topics of the same base name in every namespace"
            )
            help_ = "use the same protection in all rules on one base name"
            yield Diagnostic.note("governance-base-name", message, topic.origin, help_)
        for pattern in effective:
            yield from _topic_rules(topics, pattern, topic, lenient)
        covered += effective
    if not union_covers(tuple(covered), EVERYTHING):
        last = rule.topic_rules[-1].origin if rule.topic_rules else rule.origin
        message = "no topic rule matches every topic; a last one is added for '*', with access control and encryption"
        help_ = "end with a rule for '*' that says how all other topics are protected"
        yield Diagnostic.warning("governance-open-end", message, last, help_)
        dds_xml.topic_rule(topics, "*", STRICT_TOPIC)


def _never_matches(topic: TopicProtection, topic_patterns: Sequence[Glob]) -> Diagnostic | None:
    """Return an error for an expression that no name can match: another rule would protect the topics it is for."""
    expression = topic.expression
    raw = topic.kind == "topic"
    odd = None if raw else _ODD.search(expression)
    if topic_patterns and not odd:
        return None
    if odd and expression.startswith("/"):
        why = f"no ROS name has {odd[0]!r}" if odd.end() < len(expression) else f"no ROS name ends with {odd[0]!r}"
        help_ = "use legal ROS names: letters, digits and '_' between single slashes"
    elif raw or expression.startswith("/"):
        why = "it is not a name"
        help_ = "write the name of a topic, or remove the rule"
    elif expression.startswith("~"):
        why = "a governance has no subject, and every ROS name begins with '/'"
        help_ = "write the full name, e.g. '/talker/chatter'"
    elif expression[:3] in {"rt/", "rq/", "rr/"}:
        why = "every ROS name begins with '/', and this is the name of a DDS topic"
        help_ = f"write it into a <topic_rule>, or {expression[2:]!r} here"
    else:
        why = "every ROS name begins with '/'"
        help_ = f"write {'/' + expression!r}"
    message = f"the expression {expression!r} of this {topic.kind} rule of the governance matches no name: {why}"
    return Diagnostic.error("governance-never-matches", message, topic.origin, help_)


def patterns(topic: TopicProtection, distro: str) -> list[Glob]:
    """Return the DDS topic patterns of a topic rule's expression, without redundant ones; none if no name matches it.

    Raises:
        KeymintError: the expression is invalid.
    """
    tokens = parse_expression(topic.expression, topic.origin)
    result = [
        pattern
        for dds_topic, suffix in needed_topics(topic.kind, _PERMISSIONS[topic.kind])
        for pattern, _ in dds_patterns(distro, tokens, dds_topic, suffix)
        if pattern and not glob.is_empty(pattern)
    ]
    return [p for p in dict.fromkeys(result) if not any(q != p and covers(q, p) for q in result)]


def _topic_rules(parent: etree._Element, pattern: Glob, topic: TopicProtection, lenient: bool) -> Iterator[Diagnostic]:
    """Append the rules that protect the topics that a pattern matches; yield an error if no expression is portable."""
    texts: tuple[str, ...] = (exact(pattern),)
    try:
        texts = portable_expressions(pattern)
    except NotPortableError as error:
        severity = Severity.WARNING if lenient else Severity.ERROR
        message = f"this {topic.kind} rule cannot be expressed portably across DDS vendors: {error}"
        hint = "write the names out, or build with --allow-vendor-specific"
        yield Diagnostic("portability-expression", severity, message, topic.origin, hint)
    for text in texts:
        dds_xml.topic_rule(parent, text, {name: getattr(topic, name) for name in STRICT_TOPIC})
