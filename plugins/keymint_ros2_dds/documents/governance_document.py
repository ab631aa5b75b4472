"""The governance document: how domains and topics are protected (DDS Security 1.1, 9.4.1.2)."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from functools import lru_cache

from lxml import etree

from comarmor.errors import Diagnostic, Origin, Severity
from comarmor.patterns import glob
from comarmor.patterns.glob import EVERYTHING, Glob
from comarmor.patterns.printing import exact
from comarmor.patterns.relations import covers, union_covers
from comarmor.patterns.tokens import PatternError
from comarmor.rules import PARTS
from comarmor.text import did_you_mean
from keymint.api import DomainRule, Governance, TopicProtection
from keymint.errors import KeymintError
from keymint_ros2_dds.documents import dds_xml
from keymint_ros2_dds.domains import check_domains
from keymint_ros2_dds.layout import GOVERNANCE
from keymint_ros2_dds.lowering.dds_topics import DDS_TOPICS
from keymint_ros2_dds.lowering.mapping import ARDENT, dds_patterns
from keymint_ros2_dds.lowering.portable import NotPortableError, portable_expressions

KINDS = ("NONE", "SIGN", "ENCRYPT", "SIGN_WITH_ORIGIN_AUTHENTICATION", "ENCRYPT_WITH_ORIGIN_AUTHENTICATION")
DATA_KINDS = ("NONE", "SIGN", "ENCRYPT")

_ODD = re.compile(r"[^A-Za-z0-9_/*?\[\]!^\\-]|//|(?<=.)/$")
"""What no ROS name has, outside of the signs of an expression (ROS 2 design, "Topic and Service Names")."""
_PERMISSIONS = {
    "topic": (("topic", "publish"),),
    "ros_topic": (("ros_topic", "ros_publish"),),
    "ros_service": (("ros_service", "ros_call"),),
    "ros_action": (("ros_action", "ros_request"),),
    "ros_parameter": (("ros_parameter", "ros_read"), ("ros_parameter", "ros_write")),
}
"""One side of each kind: both sides of a ROS entity use the same DDS topics."""


def build(
    governance: Governance, subject: str, distro: str, *, allow_vendor_specific: bool
) -> tuple[bytes, tuple[Diagnostic, ...]]:
    """Return the governance document, valid against its schema, and what is to be said of it.

    Args:
        governance: what is asked for.
        subject: whose document it is.
        distro: ROS 2 distribution whose mapping of names applies. A governance document knows no partitions, so that
            for Ardent a rule is about a base name in every namespace.
        allow_vendor_specific: where vendors would differ, follow the standard and warn.

    Raises:
        KeymintError: an unknown kind of protection, or what vendors would not read alike; each with its place.
    """
    found = _compile(governance, distro, allow_vendor_specific)
    problems = tuple(
        Diagnostic(item.code, item.severity, item.message, item.where, item.help, subject) for item in found[1]
    )
    if errors := [item for item in problems if item.severity is Severity.ERROR]:
        raise KeymintError.of(errors)
    return found[0], problems


@lru_cache(maxsize=64)
def _compile(governance: Governance, distro: str, lenient: bool) -> tuple[bytes, tuple[Diagnostic, ...]]:
    """Most packages of a workspace have the same governance, so that it is compiled once."""
    problems = list(_check(governance, lenient))
    root = dds_xml.root(GOVERNANCE)
    rules = dds_xml.child(root, "domain_access_rules")
    for rule in governance.domain_rules:
        problems += _domain_rule(rules, rule, distro, lenient)
    if any(item.severity is Severity.ERROR for item in problems):
        return b"", tuple(problems)
    return dds_xml.render(root, GOVERNANCE), tuple(problems)


def _check(governance: Governance, lenient: bool) -> Iterator[Diagnostic]:
    if not governance.domain_rules:
        yield Diagnostic("governance-empty", Severity.ERROR, "the governance has no domain rule")
    for rule in governance.domain_rules:
        yield from check_domains(rule.domains, rule.domains_origin or rule.origin, "")
        for name in ("discovery", "liveliness", "rtps"):
            yield from _kind(f"{name}_protection_kind", getattr(rule, f"{name}_protection_kind"), KINDS, rule.origin)
        if rule.allow_unauthenticated_participants and rule.rtps_protection_kind != "NONE":
            yield Diagnostic(
                "portability-unauthenticated",
                Severity.WARNING if lenient else Severity.ERROR,
                "allow_unauthenticated_participants is true, but rtps_protection_kind is "
                f"{rule.rtps_protection_kind}: Fast DDS refuses to start",
                rule.origin,
                "set rtps_protection_kind to NONE, or do not allow unauthenticated participants",
            )
        for topic in rule.topic_rules:
            yield from _kind("metadata_protection_kind", topic.metadata_protection_kind, KINDS, topic.origin)
            yield from _kind("data_protection_kind", topic.data_protection_kind, DATA_KINDS, topic.origin)
            if topic.kind not in _PERMISSIONS:
                message = f"unknown kind of topic rule {topic.kind!r}"
                yield Diagnostic(
                    "governance-kind", Severity.ERROR, message, topic.origin, did_you_mean(topic.kind, _PERMISSIONS)
                )


def _kind(element: str, value: str, known: Sequence[str], where: Origin) -> Iterator[Diagnostic]:
    if value not in known:
        message = f"{element} is {value!r}, expected one of {', '.join(known)}"
        yield Diagnostic("protection-kind", Severity.ERROR, message, where, did_you_mean(value, known))


def _domain_rule(parent: etree._Element, rule: DomainRule, distro: str, lenient: bool) -> Iterator[Diagnostic]:
    element = dds_xml.child(parent, "domain_rule")
    dds_xml.domains(element, rule.domains)
    dds_xml.child(element, "allow_unauthenticated_participants", _boolean(rule.allow_unauthenticated_participants))
    dds_xml.child(element, "enable_join_access_control", _boolean(rule.enable_join_access_control))
    dds_xml.child(element, "discovery_protection_kind", rule.discovery_protection_kind)
    dds_xml.child(element, "liveliness_protection_kind", rule.liveliness_protection_kind)
    dds_xml.child(element, "rtps_protection_kind", rule.rtps_protection_kind)
    topics = dds_xml.child(element, "topic_access_rules")
    said: list[Glob] = []
    for topic in rule.topic_rules:
        if topic.kind not in _PERMISSIONS:
            continue
        images_ = patterns(topic, distro)
        if problem := _never(topic, images_):
            yield problem
            continue
        own = [pattern for pattern in images_ if not union_covers(tuple(said), pattern)]
        if not own:
            yield Diagnostic(
                "governance-shadowed", Severity.WARNING,
                f"the {topic.kind} rule for {topic.expression!r} has no effect: the rules before it match all of it",
                topic.origin, "put it before the wider rules, or remove it",
            )  # fmt: skip
        if distro == ARDENT and topic.kind != "topic":
            yield Diagnostic(
                "governance-base-name", Severity.NOTE,
                f"DDS topics of ROS 2 Ardent have base names only: the {topic.kind} rule for {topic.expression!r} is "
                "about topics of the same base name in every namespace",
                topic.origin, "let rules on one base name protect alike",
            )  # fmt: skip
        for pattern in own:
            texts, problem = _spelled(pattern, topic, lenient)
            if problem:
                yield problem
            for text in texts:
                _topic_rule(topics, text, topic)
        said += own
    if not union_covers(tuple(said), EVERYTHING):
        last = rule.topic_rules[-1].origin if rule.topic_rules else rule.origin
        yield Diagnostic(
            "governance-open-end", Severity.WARNING,
            "no topic rule matches every topic; a last one is added for '*', with access control and encryption",
            last, "end with a rule for '*' that says how all other topics are protected",
        )  # fmt: skip
        _topic_rule(topics, "*", _strictest(rule))


def _never(topic: TopicProtection, images_: Sequence[Glob]) -> Diagnostic | None:
    """Return the error for an expression that no name can match: the topics that are meant have another rule then."""
    expression = topic.expression
    raw = topic.kind == "topic"
    odd = None if raw else _ODD.search(expression)
    if images_ and not odd:
        return None
    if odd and expression.startswith("/"):
        why = f"no ROS name has {odd[0]!r}" if odd.end() < len(expression) else f"no ROS name ends with {odd[0]!r}"
        mend = "write the names as ROS has them: letters, digits and '_' between single slashes"
    elif raw or expression.startswith("/"):
        why = "it has no name to match"
        mend = "write the name of a topic, or remove the rule"
    elif expression.startswith("~"):
        why = "no subject is known here, and every ROS name begins with '/'"
        mend = "write the whole name, e.g. '/talker/chatter'"
    elif expression[:3] in {"rt/", "rq/", "rr/"}:
        why = "every ROS name begins with '/', and this is the name of a DDS topic"
        mend = f"write it into a <topic_rule>, or {expression[2:]!r} here"
    else:
        why = "every ROS name begins with '/'"
        mend = f"write {'/' + expression!r}"
    message = f"the expression {expression!r} of this {topic.kind} rule of the governance matches no name: {why}"
    return Diagnostic("governance-never-matches", Severity.ERROR, message, topic.origin, mend)


def patterns(topic: TopicProtection, distro: str) -> list[Glob]:
    """Return the images of a topic rule's expression, specific ones first; none if no name matches it.

    Raises:
        KeymintError: the expression cannot be read.
    """
    try:
        tokens = glob.parse(topic.expression)
    except PatternError as error:
        diagnostic = error.diagnostics[0]
        raise KeymintError(diagnostic.message, where=topic.origin, help=diagnostic.help, code="expression") from None
    found = [
        pattern
        for permission in _PERMISSIONS[topic.kind]
        for _, part, suffix in PARTS.get(permission, ((*permission, ""),))
        for mapped in DDS_TOPICS[part]
        for pattern, _ in dds_patterns(distro, tokens, mapped, suffix)
        if pattern and not glob.is_empty(pattern)
    ]
    return [p for p in dict.fromkeys(found) if not any(q != p and covers(q, p) for q in found)]


def _spelled(pattern: Glob, topic: TopicProtection, lenient: bool) -> tuple[tuple[str, ...], Diagnostic | None]:
    try:
        return portable_expressions(pattern), None
    except NotPortableError as error:
        severity = Severity.WARNING if lenient else Severity.ERROR
        message = f"this {topic.kind} rule cannot be said alike for all vendors: {error}"
        hint = "write the names out, or build with --allow-vendor-specific"
        return (exact(pattern),), Diagnostic("portability-expression", severity, message, topic.origin, hint)


def _topic_rule(parent: etree._Element, expression: str, topic: TopicProtection) -> None:
    element = dds_xml.child(parent, "topic_rule")
    dds_xml.child(element, "topic_expression", expression)
    dds_xml.child(element, "enable_discovery_protection", _boolean(topic.enable_discovery_protection))
    dds_xml.child(element, "enable_liveliness_protection", _boolean(topic.enable_liveliness_protection))
    dds_xml.child(element, "enable_read_access_control", _boolean(topic.enable_read_access_control))
    dds_xml.child(element, "enable_write_access_control", _boolean(topic.enable_write_access_control))
    dds_xml.child(element, "metadata_protection_kind", topic.metadata_protection_kind)
    dds_xml.child(element, "data_protection_kind", topic.data_protection_kind)


def _strictest(rule: DomainRule) -> TopicProtection:
    """Return how topics that no rule matches are protected: access control and encryption, whatever else is said."""
    return TopicProtection("topic", "*", True, True, True, True, "ENCRYPT", "ENCRYPT", rule.origin)


def _boolean(value: bool) -> str:
    return "true" if value else "false"
