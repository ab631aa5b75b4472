# SPDX-License-Identifier: Apache-2.0
"""What SROS2 writes for an enclave: the permissions document of its stylesheet (sros2 0.13, measured).

One grant for each ``<profiles>``, with one ``deny_rule`` if anything is denied, one ``allow_rule``, and from Foxy on an
``allow_rule`` for the graph. Names are those that it enforces, not those that the policy reads. It shares no code with
the compiler: the two are compared.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from lxml import etree

from comarmor.rules import Effect
from keymint_ros2_sros2.syntax import GRAPH_TOPIC, NodeGroup, RosNode, RuleList, Sros2Enclave, enforced_name

_XSI = "http://www.w3.org/2001/XMLSchema-instance"
_SCHEMA = "http://www.omg.org/spec/DDS-SECURITY/20170901/omg_shared_ca_permissions.xsd"
_BEGIN, _END = "2000-01-01T00:00:00", "2001-01-01T00:00:00"
"""Any period: SROS2 takes that of the certificate."""
_REQUESTS = tuple(f"/_action/{name}Request" for name in ("cancel_goal", "get_result", "send_goal"))
_REPLIES = tuple(f"/_action/{name}Reply" for name in ("cancel_goal", "get_result", "send_goal"))
_TOPICS = tuple(f"/_action/{name}" for name in ("feedback", "status"))

_Topic = tuple[str, str]
"""What may be done, and the DDS topic."""


def subject_name(enclave: Sros2Enclave) -> str:
    """Return the subject name of an enclave's certificate and grants."""
    return f"CN={enclave.path}"


def permissions_document(enclave: Sros2Enclave, *, graph: bool) -> bytes:
    """Return the permissions document that SROS2 writes for an enclave, for domain 0.

    Args:
        enclave: the enclave.
        graph: as SROS2 does with an RMW that has the graph's topic, from version 0.2.0 on.
    """
    root = etree.Element("dds", nsmap={"xsi": _XSI})
    root.set(f"{{{_XSI}}}noNamespaceSchemaLocation", _SCHEMA)
    permissions = etree.SubElement(root, "permissions")
    for group in enclave.groups:
        permissions.append(_grant(enclave, group, graph=graph))
    etree.indent(root)
    return etree.tostring(root, encoding="UTF-8", xml_declaration=True)


def _grant(enclave: Sros2Enclave, group: NodeGroup, *, graph: bool) -> etree._Element:
    grant = etree.Element("grant", name=enclave.path)
    etree.SubElement(grant, "subject_name").text = subject_name(enclave)
    validity = etree.SubElement(grant, "validity")
    etree.SubElement(validity, "not_before").text = _BEGIN
    etree.SubElement(validity, "not_after").text = _END
    topics = {effect: set(_topics(group, effect)) for effect in Effect}
    if topics[Effect.DENY]:
        grant.append(_rule("deny_rule", topics[Effect.DENY]))
    if topics[Effect.ALLOW]:
        grant.append(_rule("allow_rule", topics[Effect.ALLOW]))
    if graph:
        grant.append(_rule("allow_rule", {("publish", GRAPH_TOPIC), ("subscribe", GRAPH_TOPIC)}))
    etree.SubElement(grant, "default").text = "DENY"
    return grant


def _rule(tag: str, topics: Iterable[_Topic]) -> etree._Element:
    rule = etree.Element(tag)
    etree.SubElement(etree.SubElement(rule, "domains"), "id").text = "0"
    for action in ("publish", "subscribe"):
        names = sorted(name for each, name in topics if each == action)
        if names:
            listed = etree.SubElement(etree.SubElement(rule, action), "topics")
            for name in names:
                etree.SubElement(listed, "topic").text = name
    return rule


def _topics(group: NodeGroup, effect: Effect) -> Iterator[_Topic]:
    for node in group.nodes:
        for rules in node.lists:
            for permission, given in rules.effects.items():
                if given is effect:
                    yield from _of_list(node, rules, permission)


def _of_list(node: RosNode, rules: RuleList, permission: str) -> Iterator[_Topic]:
    for entry in rules.entries:
        name = enforced_name(node, entry.text)
        if permission in {"ros_publish", "ros_subscribe"}:
            yield permission.removeprefix("ros_"), f"rt{name}"
            continue
        caller = permission in {"ros_call", "ros_request"}
        out, back = ("publish", "subscribe") if caller else ("subscribe", "publish")
        composite = permission in {"ros_request", "ros_operate"}
        yield from ((out, f"rq{name}{suffix}") for suffix in (_REQUESTS if composite else ("Request",)))
        yield from ((back, f"rr{name}{suffix}") for suffix in (_REPLIES if composite else ("Reply",)))
        if composite:
            yield from ((back, f"rt{name}{suffix}") for suffix in _TOPICS)
