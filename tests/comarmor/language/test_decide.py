# SPDX-License-Identifier: Apache-2.0
"""The meaning of the language, by the examples and sentences of its definition."""

from __future__ import annotations

import pytest

import comarmor
from comarmor import Effect

from .policies import XI, profile, rule

WORKED = f"""<profiles {XI}>
  <profile name="talker">
    <attachment>*/talker</attachment>
    <xi:include href="common/node.xml" parse="xml"/>
    <ros_topic qualifier="ALLOW">
      <attachment>{{namespace}}chatter*</attachment>
      <permissions><ros_publish/></permissions>
    </ros_topic>
    <ros_topic qualifier="DENY">
      <attachment>{{namespace}}chatter_private</attachment>
      <permissions><ros_publish/><ros_subscribe/></permissions>
    </ros_topic>
  </profile>
</profiles>
"""
NODE = """<ros_topic qualifier="ALLOW" modifier="AUDIT">
  <attachment>/rosout</attachment>
  <permissions><ros_publish/></permissions>
</ros_topic>
"""


def test_worked_example(write) -> None:
    root = write({"policy.xml": WORKED, "common/node.xml": NODE})
    policy = comarmor.load(root)

    def publish(name: str) -> comarmor.Decision:
        return policy.decide("/robot1/talker", "ros_topic", "ros_publish", name)

    assert publish("/robot1/chatter").allowed
    assert publish("/robot1/chatter2").allowed
    assert not publish("/robot2/chatter").allowed
    assert not policy.decide("/robot1/talker", "ros_topic", "ros_subscribe", "/robot1/chatter").allowed
    denied = publish("/robot1/chatter_private")
    assert denied.effect is Effect.DENY
    assert str(denied.where) == f"{root}/policy.xml:9"
    assert "policy.xml:9" in str(denied.reason)
    rosout = publish("/rosout")
    assert rosout.allowed
    assert rosout.audit
    assert str(rosout.where) == f"{root}/common/node.xml:1, included from {root}/policy.xml:4"
    nothing = publish("/other")
    assert (nothing.rule, nothing.where, nothing.audit) == (None, None, False)
    assert policy.subjects() == ()
    assert policy.applicable("/robot1/listener") == ()


@pytest.mark.parametrize("order", [0, 1])
def test_deny_overrides_allow_in_any_order(load, order) -> None:
    both = [rule("ros_topic", "ALLOW", "*", "ros_publish"), rule("ros_topic", "DENY", "/x", "ros_publish")]
    policy = load(profile(*(both if order else reversed(both))))
    assert not policy.decide("/s", "ros_topic", "ros_publish", "/x").allowed
    assert policy.decide("/s", "ros_topic", "ros_publish", "/y").allowed


def test_deny_is_only_about_its_kind_and_permission(load) -> None:
    policy = load(
        profile(
            rule("ros_topic", "ALLOW", "*", "ros_publish", "ros_subscribe"),
            rule("ros_topic", "DENY", "/x", "ros_subscribe"),
            rule("topic", "DENY", "*", "publish"),
        )
    )
    assert policy.decide("/s", "ros_topic", "ros_publish", "/x").allowed
    assert not policy.decide("/s", "ros_topic", "ros_subscribe", "/x").allowed


READ = ("describe_parameters", "get_parameters", "get_parameter_types", "list_parameters")


def test_calling_everything_includes_reading_parameters(load) -> None:
    policy = load(profile(rule("ros_service", "ALLOW", "/fleet/*", "ros_call")))
    read = policy.decide("/s", "ros_parameter", "ros_read", "/fleet/x")
    assert read.allowed
    assert [part.object for part in read.parts] == [f"/fleet/x/{name}" for name in READ]
    assert policy.decide("/s", "ros_parameter", "ros_write", "/fleet/x").allowed
    assert not policy.decide("/s", "ros_parameter", "ros_read", "/other").allowed
    assert not policy.decide("/s", "ros_action", "ros_request", "/fleet/x").allowed


def test_composite_rules_act_on_their_parts(load) -> None:
    policy = load(
        profile(rule("ros_action", "ALLOW", "/a?", "ros_request"), rule("ros_parameter", "ALLOW", "/n", "ros_read"))
    )
    assert policy.decide("/s", "ros_action", "ros_request", "/a1").allowed
    assert not policy.decide("/s", "ros_action", "ros_operate", "/a1").allowed
    for service in ("send_goal", "cancel_goal", "get_result"):
        assert policy.decide("/s", "ros_service", "ros_call", f"/a1/_action/{service}").allowed
    for topic in ("feedback", "status"):
        assert policy.decide("/s", "ros_topic", "ros_subscribe", f"/a1/_action/{topic}").allowed
        assert not policy.decide("/s", "ros_topic", "ros_publish", f"/a1/_action/{topic}").allowed
    assert not policy.decide("/s", "ros_service", "ros_call", "/a1/_action/other").allowed
    assert policy.decide("/s", "ros_service", "ros_call", "/n/get_parameters").allowed
    assert not policy.decide("/s", "ros_service", "ros_call", "/n/set_parameters").allowed


def test_denying_one_part_denies_the_whole(load) -> None:
    policy = load(
        profile(rule("ros_action", "ALLOW", "*", "ros_operate"), rule("ros_topic", "DENY", "*/status", "ros_publish"))
    )
    decision = policy.decide("/s", "ros_action", "ros_operate", "/a")
    assert not decision.allowed
    assert decision.rule is not None
    assert decision.rule.kind == "ros_topic"
    assert "/a/_action/status" in str(decision.reason)
    assert policy.decide("/s", "ros_service", "ros_execute", "/a/_action/send_goal").allowed


def test_composite_deny_denies_each_part(load) -> None:
    policy = load(
        profile(rule("ros_service", "ALLOW", "*", "ros_call"), rule("ros_parameter", "DENY", "/n", "ros_write"))
    )
    assert not policy.decide("/s", "ros_service", "ros_call", "/n/set_parameters").allowed
    assert policy.decide("/s", "ros_service", "ros_call", "/n/get_parameters").allowed
    assert not policy.decide("/s", "ros_parameter", "ros_write", "/n").allowed
    assert policy.decide("/s", "ros_parameter", "ros_read", "/n").allowed


@pytest.mark.parametrize(
    ("allowed_in", "denied_in", "asked", "allowed"),
    [
        (None, None, (), False),
        ([], None, (), True),
        ([], None, ("",), True),
        ([], None, ("rt",), False),
        (["rt"], None, (), False),
        (["rt"], None, ("rt",), True),
        (["rt"], None, ("rt", "other"), False),
        (["r*", "other"], None, ("rt", "other"), True),
        (["*"], None, (), True),
        (["rt", ""], None, ("", "rt"), True),
        (["*"], ["secret"], ("rt",), True),
        (["*"], ["secret"], ("rt", "secret"), False),
        (["*"], [], ("rt",), False),
        (["*"], [""], ("rt",), True),
        (["*"], [""], (), False),
    ],
)
def test_partitions(load, allowed_in, denied_in, asked, allowed) -> None:
    rules = [
        rule("topic", effect, "/t", "publish", partitions=partitions)
        for effect, partitions in (("ALLOW", allowed_in), ("DENY", denied_in))
        if partitions is not None
    ]
    assert load(profile(*rules)).decide("/s", "topic", "publish", "/t", asked).allowed is allowed


@pytest.mark.parametrize(
    ("kind", "permission", "hint"),
    [
        ("ros_topc", "ros_publish", "did you mean 'ros_topic'?"),
        ("ros_topic", "ros_publsh", "did you mean 'ros_publish'?"),
    ],
)
def test_unknown_kind_or_permission(load, kind, permission, hint) -> None:
    with pytest.raises(comarmor.ComArmorError) as caught:
        load(profile()).decide("/s", kind, permission, "/x")
    assert caught.value.diagnostics[0].help == hint


def test_any_text_can_be_asked_about(load) -> None:
    policy = load(profile(rule("ros_topic", "ALLOW", "{namespace}*", "ros_publish"), attachment="*"))
    for text in ("", "/", "x", "a b\n", "/*", "\\", "[", "é\0", "{name}", "//"):
        namespace = text.rpartition("/")[0] + ("/" if "/" in text else "")
        assert policy.decide(text, "ros_topic", "ros_publish", f"{namespace}x").allowed
        policy.decide("/s", "topic", "publish", text, (text,))
