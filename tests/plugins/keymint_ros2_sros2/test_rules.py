# SPDX-License-Identifier: Apache-2.0
"""The rules that a policy means."""

from __future__ import annotations

from keymint_ros2_sros2.parse import parse
from keymint_ros2_sros2.syntax import rules_of

from comarmor.rules import Effect

from .sros2_policies import enclave, policy


def of(path, at: int = 0, *, implicit: bool = True) -> list[tuple]:
    found = parse(path)
    rules = rules_of([found.enclaves[at]], graph=implicit and found.has_graph)
    return [(rule.effect, rule.kind, rule.permissions, rule.expressions) for rule in rules]


def test_every_kind_and_permission(robot) -> None:
    assert of(robot, 1, implicit=False) == [
        (Effect.ALLOW, "ros_topic", ("ros_subscribe",), ("/robot/*",)),
        (Effect.DENY, "ros_topic", ("ros_publish",), ("/robot/*",)),
        (Effect.ALLOW, "ros_service", ("ros_call",), ("/robot/add",)),
        (Effect.ALLOW, "ros_action", ("ros_request",), ("/robot/dock",)),
    ]


def test_the_other_half(write) -> None:
    lists = (
        '<services reply="DENY"><service>s</service></services><actions execute="ALLOW"><action>a</action></actions>'
    )
    assert of(write(policy(enclave("/e", lists))), implicit=False) == [
        (Effect.DENY, "ros_service", ("ros_execute",), ("/s",)),
        (Effect.ALLOW, "ros_action", ("ros_operate",), ("/a",)),
    ]


def test_a_list_without_qualifiers_means_nothing(write) -> None:
    path = write(policy(enclave("/e", "<topics><topic>x</topic></topics>")))
    assert of(path, implicit=False) == []
    assert of(path) == [(Effect.ALLOW, "topic", ("publish", "subscribe"), ("ros_discovery_info",))]


def test_the_graph_topic_came_with_version_0_2_0(write) -> None:
    text = '<policy version="0.1.0"><profiles><profile ns="/" node="n"/></profiles></policy>'
    assert of(write(text)) == []
