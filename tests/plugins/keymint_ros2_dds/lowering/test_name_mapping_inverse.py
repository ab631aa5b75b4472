# SPDX-License-Identifier: Apache-2.0
"""Patterns of DDS topics become rules on ROS names that mean exactly these patterns."""

from __future__ import annotations

import pytest
from hypothesis import given, strategies as st
from keymint_ros2_dds.lowering.lowered_rules import lower
from keymint_ros2_dds.lowering.name_mapping import DDS_TOPICS, TOPIC_ACTIONS, TopicAction, in_ros

from comarmor.errors import Origin
from comarmor.patterns.expression import canonical
from comarmor.patterns.glob import Glob, parse
from comarmor.rules import KIND_OF, PERMISSIONS, Effect, Rule, of_raw_topic
from keymint.ir import SubjectRules

PUBLISH, SUBSCRIBE, RELAY = TOPIC_ACTIONS
PATTERNS = ("/a", "/a/b", "/*", "/r?/x", "/[ab]*/x", "/a/*/b*")


def found(*patterns: tuple[TopicAction, str], distro: str = "jazzy") -> set[tuple[str, str]]:
    rules = in_ros([(action, parse(text)) for action, text in patterns], distro)
    return {(permission, canonical(name)) for _, permission, name in rules}


def lowered(rules: list[Rule], distro: str = "jazzy") -> set[tuple[TopicAction, Glob]]:
    sides = lower(SubjectRules("/s", tuple(rules)), distro).allow
    return {(action, pattern) for action in TOPIC_ACTIONS for pattern, _ in sides[action]}


def rule(kind: str, permission: str, *names: str) -> Rule:
    return Rule(Effect.ALLOW, kind, (permission,), names, (), False, Origin("p.xml"))


@pytest.mark.parametrize("permission", [each for each in DDS_TOPICS if each.startswith("ros_")])
def test_queries_about_raw_topics_know_the_same_mapping(permission: str) -> None:
    for topic in DDS_TOPICS[permission]:
        raw = f"{topic.prefix}/a/b{topic.suffix}"
        assert of_raw_topic(str(topic.action), raw) == (KIND_OF[permission], permission, "/a/b")


@pytest.mark.parametrize(
    ("patterns", "expected"),
    [
        ([(PUBLISH, "rt/a"), (RELAY, "rt/*")], {("ros_publish", "/a"), ("ros_relay", "/*")}),
        ([(PUBLISH, "rq/aRequest"), (SUBSCRIBE, "rr/aReply")], {("ros_call", "/a")}),
        ([(SUBSCRIBE, "rq/*Request"), (PUBLISH, "rr/*Reply")], {("ros_execute", "/*")}),
        ([(PUBLISH, "rq/aRequest"), (SUBSCRIBE, "rr/bReply")],
         {("publish", "rq/aRequest"), ("subscribe", "rr/bReply")}),
        ([(PUBLISH, "rq/Request"), (SUBSCRIBE, "rr/Reply")], {("publish", "rq/Request"), ("subscribe", "rr/Reply")}),
        ([(PUBLISH, "rt*"), (PUBLISH, "rt"), (PUBLISH, "rt/")],
         {("publish", "rt*"), ("publish", "rt"), ("publish", "rt/")}),
        ([(PUBLISH, "rt/no name"), (PUBLISH, "rt//x")], {("publish", "rt/no\\ name"), ("publish", "rt//x")}),
        ([(PUBLISH, "r[t]/a"), (PUBLISH, "*")], {("ros_publish", "/a"), ("publish", "*")}),
        ([(PUBLISH, "rq/{a}Request")], {("publish", "rq/\\{a\\}Request")}),
    ],
)  # fmt: skip
def test_names(patterns: list[tuple[TopicAction, str]], expected: set[tuple[str, str]]) -> None:
    assert found(*patterns) == expected


def test_an_action_needs_all_its_parts() -> None:
    parts = [(PUBLISH, f"rq/dock/_action/{each}Request") for each in ("send_goal", "cancel_goal", "get_result")]
    parts += [(SUBSCRIBE, f"rr/dock/_action/{each}Reply") for each in ("send_goal", "cancel_goal", "get_result")]
    parts += [(SUBSCRIBE, f"rt/dock/_action/{each}") for each in ("feedback", "status")]
    assert found(*parts) == {("ros_request", "/dock")}
    assert ("ros_subscribe", "/dock/_action/feedback") in found(*parts[:-1])
    assert not {each for each in found(*parts[1:]) if each[0] == "ros_request"}


def test_ardent_has_its_names_in_partitions() -> None:
    assert found((PUBLISH, "rt/a"), distro="ardent") == {("publish", "rt/a")}


@given(
    st.lists(
        st.sampled_from(
            [
                (kind, permission)
                for kind, permissions in PERMISSIONS.items()
                for permission in permissions
                if kind not in ("topic", "ros_parameter")
            ]
        ).flatmap(lambda held: st.tuples(st.just(held), st.sampled_from(PATTERNS))),
        max_size=6,
    )
)
def test_what_rules_mean_comes_back_as_rules_that_mean_the_same(drawn: list[tuple[tuple[str, str], str]]) -> None:
    given_rules = [rule(*held, name) for held, name in drawn]
    topics = lowered(given_rules)
    back = [rule(kind, permission, canonical(name)) for kind, permission, name in in_ros(topics, "jazzy")]
    assert lowered(back) == topics
    assert all(each.kind != "topic" for each in back)
