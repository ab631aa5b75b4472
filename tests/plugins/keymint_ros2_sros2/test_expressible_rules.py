# SPDX-License-Identifier: Apache-2.0
"""What a policy of SROS2 can say of a rule, and what it cannot."""

from __future__ import annotations

import pytest
from keymint_ros2_sros2.export import UnsayableError, expressed_names, is_graph

from comarmor.errors import Origin
from comarmor.rules import Effect, Rule


def rule(
    kind: str, permission: str, text: str, effect: Effect = Effect.ALLOW, partitions: tuple[str, ...] = ()
) -> Rule:
    return Rule(effect, kind, (permission,), (text,), partitions, False, Origin("p.xml", 1))


def names(kind: str, permission: str, text: str, *more) -> set[tuple[str, str, str]]:
    return set(expressed_names(rule(kind, permission, text, *more), permission, text))


@pytest.mark.parametrize(
    ("kind", "permission", "text", "expected"),
    [
        ("ros_topic", "ros_publish", "/x", {("topics", "ros_publish", "/x")}),
        ("ros_topic", "ros_publish", "*/x", {("topics", "ros_publish", "/x"), ("topics", "ros_publish", "/*/x")}),
        ("ros_topic", "ros_publish", "?x", {("topics", "ros_publish", "/x")}),
        ("ros_topic", "ros_publish", "[/]x", {("topics", "ros_publish", "/x")}),
        ("ros_topic", "ros_publish", "x", set()),
        ("ros_topic", "ros_publish", r"/a\*b", {("topics", "ros_publish", "/a[*]b")}),
        ("ros_topic", "ros_publish", r"/\{x\}", {("topics", "ros_publish", "/{x}")}),
        ("ros_topic", "ros_publish", r"/[a-z0-9_\-]", {("topics", "ros_publish", "/[0-9_a-z-]")}),
        ("ros_topic", "ros_publish", "/[!-_]", {("topics", "ros_publish", "/[!_-]")}),
        ("ros_service", "ros_call", "/s", {("services", "ros_call", "/s")}),
        ("ros_action", "ros_operate", "/a*", {("actions", "ros_operate", "/a*")}),
        ("ros_parameter", "ros_write", "/n", {
            ("services", "ros_call", "/n/set_parameters"), ("services", "ros_call", "/n/set_parameters_atomically")}),
        ("topic", "subscribe", "rt/x", {("topics", "ros_subscribe", "/x")}),
        ("topic", "subscribe", "rt/x*", {("topics", "ros_subscribe", "/x*")}),
    ],
)  # fmt: skip
def test_said(kind: str, permission: str, text: str, expected: set) -> None:
    assert names(kind, permission, text) == expected
    assert names(kind, permission, text, Effect.DENY) == expected


def test_an_action_that_may_begin_anywhere_is_said_by_its_parts() -> None:
    found = names("ros_action", "ros_request", "*")
    assert {tag for tag, _, _ in found} == {"topics", "services"}
    assert ("topics", "ros_subscribe", "/_action/status") in found
    assert ("topics", "ros_subscribe", "/*/_action/status") in found
    assert len(found) == 10


@pytest.mark.parametrize(
    ("kind", "permission", "text", "effect", "partitions"),
    [
        ("ros_topic", "ros_relay", "/x", Effect.ALLOW, ()),
        ("topic", "relay", "rt/x", Effect.ALLOW, ()),
        ("topic", "publish", "rt/x", Effect.ALLOW, ("p",)),
        ("topic", "publish", "x", Effect.ALLOW, ()),
        ("topic", "publish", "r*", Effect.ALLOW, ()),
        ("topic", "publish", "rq/xRequest", Effect.ALLOW, ()),
        ("topic", "publish", "rq/xRequest", Effect.DENY, ()),
        ("topic", "publish", "*", Effect.DENY, ()),
        ("topic", "publish", "ros_*", Effect.DENY, ()),
        ("ros_topic", "ros_publish", "/a\\\\b", Effect.ALLOW, ()),
        ("ros_topic", "ros_publish", "/a\\ ", Effect.ALLOW, ()),
    ],
)
def test_not_said(kind: str, permission: str, text: str, effect: Effect, partitions: tuple[str, ...]) -> None:
    with pytest.raises(UnsayableError):
        names(kind, permission, text, effect, partitions)


@pytest.mark.parametrize(
    ("permission", "text", "partitions", "number"),
    [
        ("relay", "rt/x", (), 0),
        ("publish", "rt/x", ("p", "q*"), 0),
        ("publish", "rt/x", ("p", "*"), 1),
        ("publish", "x", (), 0),
    ],
)
def test_a_denial_says_what_sros2_could_allow(permission: str, text: str, partitions: tuple, number: int) -> None:
    assert len(names("topic", permission, text, Effect.DENY, partitions)) == number


def test_the_topic_of_the_graph() -> None:
    assert is_graph(rule("topic", "publish", "ros_discovery_info"), "publish", "ros_discovery_info")
    assert not is_graph(rule("topic", "relay", "ros_discovery_info"), "relay", "ros_discovery_info")
    denial = rule("topic", "publish", "ros_discovery_info", Effect.DENY)
    assert not is_graph(denial, "publish", "ros_discovery_info")
