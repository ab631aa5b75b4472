# SPDX-License-Identifier: Apache-2.0
"""The rules that apply to an edge, DENY rules first; and the rule that nearly does."""

from __future__ import annotations

import pytest

from comarmor.errors import Origin
from comarmor.rules import Effect
from keymint.api.graph import Edge, Object
from keymint.ir import Rule
from keymint.verify.why import matching_rules, nearest


def rule(kind: str, permissions: str, expression: str, *, deny: bool = False, partitions: tuple[str, ...] = ()) -> Rule:
    effect = Effect.DENY if deny else Effect.ALLOW
    return Rule(effect, kind, tuple(permissions.split()), (expression,), partitions, False, Origin("p.xml", 1))


def edge(kind: str, permission: str, name: str, *partitions: str) -> Edge:
    return Edge("/s", permission, Object(kind, name, partitions))


def test_rules_that_apply_come_in_the_order_of_the_policy_with_denials_first() -> None:
    rules = [
        rule("ros_topic", "ros_publish", "/a*"),
        rule("ros_topic", "ros_subscribe", "/a"),
        rule("ros_topic", "ros_publish", "/a", deny=True),
        rule("ros_topic", "ros_publish ros_subscribe", "*"),
        rule("ros_topic", "ros_publish", "/b"),
    ]
    publish_a, publish_b = (edge("ros_topic", "ros_publish", name) for name in ("/a", "/b"))
    assert matching_rules(rules, [publish_a]) == [2, 0, 3]
    assert matching_rules(rules, [publish_a, publish_b, publish_a]) == [2, 0, 3, 4]
    assert matching_rules(rules, []) == []


def test_a_rule_on_a_part_applies_to_the_composite_permission_and_the_other_way_round() -> None:
    rules = [
        rule("ros_service", "ros_call", "/n/get_parameters", deny=True),
        rule("ros_parameter", "ros_read", "/n"),
        rule("ros_parameter", "ros_write", "/n"),
    ]
    assert matching_rules(rules, [edge("ros_parameter", "ros_read", "/n")]) == [0, 1]
    assert matching_rules(rules, [edge("ros_service", "ros_call", "/n/list_parameters")]) == [1]
    assert matching_rules(rules, [edge("ros_service", "ros_call", "/n/other")]) == []


@pytest.mark.parametrize(
    ("partitions", "expected"), [((), [0, 2]), (("p",), [0, 1]), (("", "p"), [0, 1, 2]), (("q",), [0])]
)
def test_a_rule_applies_if_it_applies_to_any_partition(partitions: tuple[str, ...], expected: list[int]) -> None:
    rules = [
        rule("topic", "publish", "t", deny=True),
        rule("topic", "publish", "t", partitions=("p",)),
        rule("topic", "publish", "t"),
    ]
    assert matching_rules(rules, [edge("topic", "publish", "t", *partitions)]) == expected


PARTITIONED = rule("topic", "publish", "t", partitions=("p",))
OTHER_PERMISSION = rule("ros_topic", "ros_subscribe", "/scan")
OTHER_KIND = rule("ros_service", "ros_call", "/scan")
SIMILAR = rule("ros_topic", "ros_publish", "/scans")


@pytest.mark.parametrize(
    ("rules", "request_", "position", "note"),
    [
        ([PARTITIONED], edge("topic", "publish", "t"), 0, "it applies to partitions 'p'"),
        ([rule("topic", "publish", "t")], edge("topic", "publish", "t", "p"), 0, "the default partition only"),
        ([SIMILAR, OTHER_KIND, OTHER_PERMISSION], edge("ros_topic", "ros_publish", "/scan"), 2, "not ros_publish"),
        ([SIMILAR, OTHER_KIND], edge("ros_topic", "ros_publish", "/scan"), 1, "it is a ros_service rule"),
        ([OTHER_PERMISSION, SIMILAR], edge("ros_topic", "ros_publish", "/scam"), 1, "did you mean that?"),
    ],
)
def test_the_nearest_rule(rules: list[Rule], request_: Edge, position: int, note: str) -> None:
    near = nearest(rules, request_)
    assert near is not None
    assert near.rule is rules[position]
    assert note in near.note


def test_no_rule_is_near() -> None:
    denial = rule("ros_topic", "ros_publish", "/scan", deny=True)
    wide = rule("ros_service", "ros_call", "*")
    far = rule("ros_topic", "ros_publish", "/something/else")
    assert nearest([denial, wide, far], edge("ros_topic", "ros_publish", "/scan")) is None
