# SPDX-License-Identifier: Apache-2.0
"""What a router permits a subject is what the policy allows it."""

from __future__ import annotations

import subprocess
import sys

import pytest
from hypothesis import given, settings
from keymint_ros2_zenoh.documents.configuration import AclRule, Flow, Message, Permission
from keymint_ros2_zenoh.lowering.key_rules import MAX_DOMAINS, lower_package
from keymint_ros2_zenoh.lowering.permissions import SLOTS, USERS, Place, Slot

from comarmor.errors import Diagnostic, Origin
from comarmor.rules import PARTS, Effect, Rule
from keymint.api import DomainRange
from keymint.errors import KeymintError
from keymint.ir import SubjectRules
from tests.conftest import CHECKOUT
from tests.effort import tries
from tests.plugins.keymint_ros2_zenoh.workspaces import package

from .policies import KIND, NAMES, TYPED, matched, policies, policy_allows, router_permits, rule, subject_rules

WHERE = Origin("package.xml", 7)
IN, OUT = Flow.INGRESS, Flow.EGRESS
LoweredKeys = tuple[tuple[AclRule, ...], tuple[Diagnostic, ...]]


def lowered(rules: SubjectRules, *domains: DomainRange) -> LoweredKeys:
    return lower_package(
        package(*rules.rules, subject=rules.subject, domains=domains or (DomainRange(0, 0),), domains_origin=WHERE)
    )


def permits(result: LoweredKeys, message: Message, flow: Flow, key: str) -> bool:
    return router_permits(result[0], message, flow, key)


def key(name: str, slot: Slot) -> str:
    beside = "/@adv/pub/4/2/_" if slot.place is Place.ADVANCED else ""
    return f"0{name}/{TYPED}{beside}"


def needed(result: LoweredKeys, permission: str, name: str) -> set[bool]:
    return {permits(result, slot.message, slot.flow, key(name, slot)) for slot in SLOTS[permission]}


@settings(max_examples=tries(30, 60))
@given(policies())
def test_each_slot_is_permitted_where_a_permission_needs_it(rules: SubjectRules) -> None:
    result = lowered(rules)
    for name in NAMES:
        allowed = {permission for permission in KIND if policy_allows(rules, permission, name)}
        for slot, users in USERS.items():
            permitted = permits(result, slot.message, slot.flow, key(name, slot))
            if users & allowed:
                assert permitted, (name, slot)
            elif len(users) < 2:
                assert not permitted, (name, slot)


@settings(max_examples=tries(30, 60))
@given(policies())
def test_a_reply_is_never_permitted_where_every_use_of_it_is_denied_or_not_allowed(rules: SubjectRules) -> None:
    result = lowered(rules)
    for name in NAMES:
        for flow, users in ((IN, ("ros_publish", "ros_execute")), (OUT, ("ros_subscribe", "ros_call"))):
            if not permits(result, Message.REPLY, flow, f"0{name}/{TYPED}"):
                continue
            assert any(matched(rules, Effect.ALLOW, user, name) for user in users)
            assert not all(matched(rules, Effect.DENY, user, name) for user in users)


@settings(max_examples=tries(30, 60))
@given(policies())
def test_without_any_of_its_slots_a_denied_permission_cannot_be_used(rules: SubjectRules) -> None:
    result = lowered(rules)
    for name in NAMES:
        for permission in KIND:
            assert needed(result, permission, name) == {True} or not policy_allows(rules, permission, name)
            if not policy_allows(rules, permission, name):
                assert False in needed(result, permission, name)


def test_a_denied_topic_leaves_the_service_of_its_name() -> None:
    result = lowered(
        subject_rules(
            rule("ALLOW", "ros_service", ["ros_call", "ros_execute"], "/x"),
            rule("ALLOW", "ros_topic", ["ros_publish", "ros_subscribe"], "/*"),
            rule("DENY", "ros_topic", ["ros_publish", "ros_subscribe"], "/x"),
        )
    )
    assert needed(result, "ros_call", "/x") == needed(result, "ros_execute", "/x") == {True}
    assert needed(result, "ros_publish", "/y") == {True}
    assert not permits(result, Message.PUT, IN, f"0/x/{TYPED}")
    assert not permits(result, Message.QUERY, IN, f"0/x/{TYPED}/@adv/**")
    assert not permits(result, Message.DECLARE_QUERYABLE, IN, f"0/x/{TYPED}/@adv/pub/4/2/_")


def test_a_denied_publication_leaves_the_subscription() -> None:
    result = lowered(
        subject_rules(
            rule("ALLOW", "ros_topic", ["ros_publish", "ros_subscribe"], "/*"),
            rule("DENY", "ros_topic", ["ros_publish"], "/x"),
        )
    )
    assert needed(result, "ros_subscribe", "/x") == {True}
    assert not permits(result, Message.PUT, IN, f"0/x/{TYPED}")
    assert not permits(result, Message.REPLY, IN, f"0/x/{TYPED}")


def test_a_denial_of_everything_denies_all_messages_in_both_flows() -> None:
    rules = subject_rules(
        rule("ALLOW", "ros_topic", ["ros_publish", "ros_subscribe"], "/*"),
        rule("DENY", "ros_topic", ["ros_publish", "ros_subscribe"], "/x"),
    )
    [denial] = [each for each in lowered(rules)[0] if each.permission is Permission.DENY]
    assert denial.messages == tuple(Message)
    assert denial.flows == (IN, OUT)
    assert denial.key_exprs == ("0/x/*/*", "0/x/*/*/@adv/**")


def test_replies_that_both_uses_deny_are_denied() -> None:
    result = lowered(
        subject_rules(
            rule("ALLOW", "ros_topic", ["ros_publish"], "/*"),
            rule("ALLOW", "ros_service", ["ros_execute"], "/*"),
            rule("DENY", "ros_topic", ["ros_publish"], "/a*"),
            rule("DENY", "ros_service", ["ros_execute"], "/*b"),
        )
    )
    assert not permits(result, Message.REPLY, IN, f"0/ab/{TYPED}")
    assert permits(result, Message.REPLY, IN, f"0/a/{TYPED}")
    assert permits(result, Message.REPLY, IN, f"0/b/{TYPED}")


@pytest.mark.parametrize(("kind", "permission"), PARTS)
def test_composite_permissions_become_their_parts(kind: str, permission: str) -> None:
    result = lowered(subject_rules(rule("ALLOW", kind, [permission], "/n")))
    for _, part, suffix in PARTS[kind, permission]:
        assert needed(result, part, f"/n{suffix}") == {True}
        assert False in needed(result, part, "/n")


def test_own_tokens_and_the_graph() -> None:
    result = lowered(subject_rules(), DomainRange(3, 3))
    own = "@ros2_lv/3/7/0/0/MP/%robot1%talker/%/talker/%chatter/String/RIHS01_0/q"
    assert permits(result, Message.LIVELINESS_TOKEN, IN, own)
    assert not permits(result, Message.LIVELINESS_TOKEN, IN, own.replace("robot1", "robot2"))
    assert not permits(result, Message.LIVELINESS_TOKEN, IN, own.replace("%robot1%talker", "%robot1%talker2"))
    assert not permits(result, Message.LIVELINESS_TOKEN, IN, own.replace("/3/", "/4/"))
    for message, flow in (
        (Message.LIVELINESS_QUERY, IN),
        (Message.DECLARE_LIVELINESS_SUBSCRIBER, IN),
        (Message.LIVELINESS_TOKEN, OUT),
    ):
        assert permits(result, message, flow, "@ros2_lv/3/**")
        assert not permits(result, message, flow, "@ros2_lv/4/**")
    assert not permits(result, Message.PUT, IN, own)


def test_each_domain_repeats_the_rules() -> None:
    rules = subject_rules(rule("ALLOW", "ros_topic", ["ros_publish"], "/x"))
    result = lowered(rules, DomainRange(1, 2), DomainRange(2, 2), DomainRange(5, 5))
    assert [permits(result, Message.PUT, IN, f"{domain}/x/{TYPED}") for domain in range(7)] == [
        False, True, True, False, False, True, False,
    ]  # fmt: skip


def test_too_many_domains() -> None:
    with pytest.raises(KeymintError, match=rf"^package.xml:7: .*more than {MAX_DOMAINS} domains") as caught:
        lowered(subject_rules(), DomainRange(0, 10**9))
    assert caught.value.diagnostics[0].code == "zenoh-domains"


def test_the_order_of_rules_is_the_same_in_every_process() -> None:
    """Where a rule denies two permissions that share a reply each, which other rules allow on other names."""
    script = (
        "from tests.plugins.keymint_ros2_zenoh.lowering.test_key_rules import lowered, rule, subject_rules\n"
        "print(lowered(subject_rules(\n"
        "    rule('DENY', 'ros_topic', ['ros_publish', 'ros_subscribe'], '/a*', line=1),\n"
        "    rule('ALLOW', 'ros_service', ['ros_call', 'ros_execute'], '/*', line=2),\n"
        "    rule('DENY', 'ros_service', ['ros_call'], '/ab*', line=3),\n"
        "    rule('DENY', 'ros_service', ['ros_execute'], '/ac*', line=4),\n"
        "))[0])\n"
    )
    printed = {
        subprocess.run(
            [sys.executable, "-c", script],
            cwd=CHECKOUT,
            env={"PYTHONHASHSEED": seed},
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for seed in "012"
    }
    assert len(printed) == 1


def raw(effect: str, *permissions: str, partitions: tuple[str, ...] = ()) -> Rule:
    return Rule(
        Effect(effect), "topic", permissions, ("ros_discovery_info",), partitions, False, Origin("common/graph.xml", 4)
    )


def test_the_infrastructure_of_dds_is_left_out_and_reported_once() -> None:
    both = raw("ALLOW", "publish", "subscribe")
    result = lowered(subject_rules(both, both))
    assert result[0] == lowered(subject_rules())[0]
    assert [(each.code, str(each.where)) for each in result[1]] == [("zenoh-infrastructure", "common/graph.xml:4")]


def test_a_warning_before_it_does_not_hide_that_it_is_left_out() -> None:
    result = lowered(subject_rules(rule("ALLOW", "ros_topic", ["ros_publish"], "a"), raw("ALLOW", "publish")))
    assert [each.code for each in result[1]] == ["never-matches", "zenoh-infrastructure"]


@pytest.mark.parametrize(
    "other",
    [raw("DENY", "publish"), raw("ALLOW", "publish", partitions=("p",)), raw("ALLOW", "publish", "relay")],
    ids=["denied", "partition", "relay"],
)
def test_other_raw_rules_are_errors(other: Rule) -> None:
    with pytest.raises(KeymintError, match="names DDS topics by their own names") as caught:
        lowered(subject_rules(other))
    assert caught.value.diagnostics[0].where == other.origin
