# SPDX-License-Identifier: Apache-2.0
"""The governance document."""

from __future__ import annotations

import pytest
from keymint_ros2_dds import build_type
from lxml import etree

from keymint.api import BuildOptions, DomainRange
from keymint.errors import KeymintError
from tests.plugins.keymint_ros2_dds.packages import domain_rule, governed, package, protection, rule

STRICT, LENIENT = BuildOptions(), BuildOptions(allow_vendor_specific=True)


def build(*topics, options=STRICT, **fields):
    loaded = package(rule("ALLOW", "ros_topic", "ros_publish", "/chatter"))
    return build_type.build(governed(loaded, domain_rules=(domain_rule(*topics, **fields),)), options)


def expressions(built):
    root = etree.fromstring(built.documents["governance.xml"])
    return [item.text for item in root.iter("topic_expression")]


def codes(*topics, **fields):
    with pytest.raises(KeymintError) as caught:
        build(*topics, **fields)
    return [item.code for item in caught.value.diagnostics]


def test_every_element_of_the_standard_in_its_order():
    root = etree.fromstring(build(protection(data_protection_kind="NONE")).documents["governance.xml"])
    domain = root.find("domain_access_rules/domain_rule")
    assert [(item.tag, item.text) for item in domain][1:-1] == [
        ("allow_unauthenticated_participants", "false"),
        ("enable_join_access_control", "true"),
        ("discovery_protection_kind", "ENCRYPT"),
        ("liveliness_protection_kind", "ENCRYPT"),
        ("rtps_protection_kind", "SIGN"),
    ]
    assert [(item.tag, item.text) for item in domain.find("topic_access_rules/topic_rule")] == [
        ("topic_expression", "*"),
        ("enable_discovery_protection", "true"),
        ("enable_liveliness_protection", "true"),
        ("enable_read_access_control", "true"),
        ("enable_write_access_control", "true"),
        ("metadata_protection_kind", "ENCRYPT"),
        ("data_protection_kind", "NONE"),
    ]


def test_expressions_over_ros_names_are_mapped_in_their_order():
    built = build(
        protection("ros_topic", "*/image"),
        protection("ros_service", "/add"),
        protection("ros_action", "/fib"),
        protection("ros_parameter", "/node"),
        protection("topic", "raw*"),
        protection(),
    )
    found = expressions(built)
    assert set(found[:2]) == {"rt/image", "rt/*/image"}
    assert found[2:4] == ["rq/addRequest", "rr/addReply"]
    assert {"rq/fib/_action/send_goalRequest", "rr/fib/_action/send_goalReply", "rt/fib/_action/status"} <= set(found)
    assert {"rq/node/get_parametersRequest", "rr/node/set_parametersReply"} <= set(found)
    assert found[-2:] == ["raw*", "*"]
    assert len(found) == len(set(found)) == 2 + 2 + 8 + 12 + 2


def test_it_always_ends_with_every_topic():
    built = build(protection("ros_topic", "/chatter", enable_read_access_control=False, data_protection_kind="NONE"))
    assert expressions(built) == ["rt/chatter", "*"]
    assert [found.code for found in built.diagnostics] == ["governance-open-end", "governance-open"]
    last = etree.fromstring(built.documents["governance.xml"]).findall(".//topic_rule")[-1]
    assert last.findtext("enable_read_access_control") == "true"
    assert last.findtext("data_protection_kind") == "ENCRYPT"


def test_a_rule_that_comes_too_late_is_a_warning():
    built = build(protection(), protection("ros_topic", "/late"))
    assert expressions(built) == ["*"]
    assert [found.code for found in built.diagnostics] == ["governance-shadowed"]


def test_unauthenticated_participants_with_protected_rtps():
    assert codes(allow_unauthenticated_participants=True) == ["portability-unauthenticated"]
    assert [
        found.code for found in build(allow_unauthenticated_participants=True, rtps_protection_kind="NONE").diagnostics
    ] == ["governance-open-join"]
    lenient = build(allow_unauthenticated_participants=True, options=LENIENT)
    assert [found.code for found in lenient.diagnostics] == ["portability-unauthenticated", "governance-open-join"]


def test_expressions_that_vendors_read_differently():
    assert codes(protection("topic", r"a\*"), protection()) == ["portability-expression"]
    assert expressions(build(protection("topic", r"a\*"), protection(), options=LENIENT)) == [r"a\*", "*"]


def test_domains():
    assert "portability-domain" in codes(domains=(DomainRange(0, 300),))
    wide = build(domains=(DomainRange(0, 3), DomainRange(7, 7)))
    found = etree.fromstring(wide.documents["governance.xml"]).find(".//domains")
    assert [(item.tag, item.text) for item in found.iter() if not len(item)] == [
        ("min", "0"),
        ("max", "3"),
        ("id", "7"),
    ]


def test_no_domain_rule_at_all():
    loaded = package(rule("ALLOW", "ros_topic", "ros_publish", "/chatter"))
    with pytest.raises(KeymintError, match="expected <domain_rule>"):
        build_type.build(governed(loaded, domain_rules=()), STRICT)


@pytest.mark.parametrize(
    ("kind", "expression", "why", "mend"),
    [
        ("ros_topic", "chatter", "every ROS name begins with '/'", "write '/chatter'"),
        ("ros_service", "robot*/add", "every ROS name begins with '/'", "write '/robot*/add'"),
        ("ros_topic", "rt/chatter", "the name of a DDS topic", "<topic_rule>, or '/chatter' here"),
        ("ros_topic", "~/chatter", "every ROS name begins with '/'", "the full name"),
        ("ros_action", "/rover/(turn|move)", "no ROS name has '('", "letters, digits"),
        ("ros_topic", "/scan.raw", "no ROS name has '.'", "letters, digits"),
        ("ros_topic", "/scan//raw", "no ROS name has '//'", "single slashes"),
        ("ros_parameter", "/node/", "no ROS name ends with '/'", "single slashes"),
        ("topic", "rt/[]", "it is not a name", "remove the rule"),
    ],
)
def test_an_expression_that_matches_no_name_is_an_error_that_says_why(kind, expression, why, mend):
    if expression == "rt/[]":
        expression = "rt/[z-a]"
    with pytest.raises(KeymintError) as caught:
        build(protection(kind, expression, data_protection_kind="NONE"), protection(), options=LENIENT)
    (found,) = caught.value.diagnostics
    assert (found.code, found.severity, str(found.where)) == ("governance-never-matches", "error", "policy.xml:7")
    assert f"{expression!r}" in found.message
    assert why in found.message
    assert mend in found.help
