# SPDX-License-Identifier: Apache-2.0
"""The model of Zenoh's access control, rule by rule; tests/real compares it with the library."""

from __future__ import annotations

import pytest
from hypothesis import given, strategies as st
from keymint_ros2_zenoh.decision import AccessModel, Link
from keymint_ros2_zenoh.documents.configuration import (
    AccessControl,
    AclPolicy,
    AclRule,
    AclSubject,
    Flow,
    Message,
    Permission,
)

from comarmor.errors import Origin

IN, OUT = Flow.INGRESS, Flow.EGRESS
PUT, QUERY = Message.PUT, Message.QUERY
TALKER = Link("/talker", interface="lo", protocol="tls")


def rule(name: str, effect: str, *key_exprs: str, messages=(PUT,), flows=(IN,), line: int = 0) -> AclRule:
    where = Origin("router.json5", line) if line else None
    return AclRule(name, tuple(messages), tuple(flows), Permission(effect), key_exprs, where)


def control(
    *rules: AclRule, subjects: tuple[AclSubject, ...] = (AclSubject("s", ("/talker",)),), default: str = "deny"
) -> AccessControl:
    """All rules for all subjects."""
    policy = AclPolicy(tuple(each.id for each in rules), tuple(each.id for each in subjects))
    return AccessControl(True, Permission(default), rules, subjects, (policy,) if rules and subjects else ())


def allowed(access: AccessControl, key: str, link: Link = TALKER, message: Message = PUT, flow: Flow = IN) -> bool:
    return AccessModel(access).on(link).decide(message, flow, key).allowed


def test_a_rule_applies_to_its_messages_and_flows_only() -> None:
    access = control(rule("r", "allow", "0/x"))
    assert allowed(access, "0/x")
    assert not allowed(access, "0/y")
    assert not allowed(access, "0/x", message=Message.DELETE)
    assert not allowed(access, "0/x", flow=OUT)


def test_deny_overrides_allow_in_any_order() -> None:
    allow, deny = rule("a", "allow", "0/**"), rule("d", "deny", "0/secret/**")
    for rules in ((allow, deny), (deny, allow)):
        assert allowed(control(*rules), "0/chatter")
        assert not allowed(control(*rules), "0/secret/x")


@pytest.mark.parametrize("key", ["0/*/x", "0/se$*/x", "0/**"])
def test_a_deny_does_not_touch_a_wider_key(key: str) -> None:
    access = control(rule("a", "allow", "0/**"), rule("d", "deny", "0/secret/**"))
    assert allowed(access, key)


@pytest.mark.parametrize("key", ["0/secret/x", "0/secret/*", "0/secret/**", "0/secret/$*x", "**"])
def test_a_deny_touches_what_it_includes_and_an_allow_only_that(key: str) -> None:
    assert not allowed(control(rule("a", "allow", "0/**"), rule("d", "deny", "0/secret/**")), key)


def test_verbatim_chunks_need_a_rule_of_their_own() -> None:
    access = control(rule("a", "allow", "0/**"))
    assert not allowed(access, "0/x/@adv/pub")
    assert allowed(control(rule("a", "allow", "0/**", "0/x/@adv/**")), "0/x/@adv/pub")


def test_a_link_without_subject_gets_the_default() -> None:
    other = Link("/listener")
    assert not allowed(control(rule("a", "allow", "**")), "0/x", other)
    assert allowed(control(rule("d", "deny", "**"), default="allow"), "0/x", other)


@pytest.mark.parametrize("name", ["/Talker", "/talker/", "/talke", "/talker2", ""])
def test_common_names_are_compared_exactly(name: str) -> None:
    assert not allowed(control(rule("a", "allow", "**")), "0/x", Link(name))


def test_a_property_left_out_matches_any_and_all_that_are_given_must_match() -> None:
    anyone = (AclSubject("s"),)
    assert allowed(control(rule("a", "allow", "**"), subjects=anyone), "0/x", Link("/whoever"))
    on_ethernet = (AclSubject("s", ("/talker",), interfaces=("eth0",)),)
    assert not allowed(control(rule("a", "allow", "**"), subjects=on_ethernet), "0/x")
    of_two = (AclSubject("s", ("/listener", "/talker"), link_protocols=("quic", "tls")),)
    assert allowed(control(rule("a", "allow", "**"), subjects=of_two), "0/x")


def test_a_deny_on_a_wildcard_subject_is_undone_by_an_allow_on_the_name() -> None:
    subjects = (AclSubject("everyone"), AclSubject("talker", ("/talker",)))
    rules = (rule("d", "deny", "**"), rule("a", "allow", "0/x"))
    policies = (AclPolicy(("d",), ("everyone",)), AclPolicy(("a",), ("talker",)))
    access = AccessControl(True, Permission.DENY, rules, subjects, policies)
    assert allowed(access, "0/x")
    assert not allowed(access, "0/y")


def test_subjects_with_equal_properties_are_one_entry() -> None:
    subjects = (AclSubject("one", ("/talker",)), AclSubject("two", ("/talker", "/other")))
    rules = (rule("d", "deny", "0/x"), rule("a", "allow", "**"))
    policies = (AclPolicy(("d",), ("one",)), AclPolicy(("a",), ("two",)))
    access = AccessControl(True, Permission.DENY, rules, subjects, policies)
    assert not allowed(access, "0/x")
    assert allowed(access, "0/x", Link("/other"))


def test_a_subject_without_policy_has_the_default_and_not_another_entrys_rules() -> None:
    subjects = (AclSubject("idle", ("/talker",)),)
    assert not allowed(control(subjects=subjects), "0/x")
    assert allowed(control(subjects=subjects, default="allow"), "0/x")


def test_without_access_control_everything_is_allowed() -> None:
    assert allowed(AccessControl(enabled=False, default_permission=Permission.DENY), "0/x")


def test_the_decision_names_the_rule_and_its_place() -> None:
    access = control(rule("a", "allow", "0/**", line=3), rule("d", "deny", "0/secret/**", line=7))
    model = AccessModel(access)
    for key, name, line in (("0/x", "a", 3), ("0/secret/x", "d", 7)):
        decision = model.on(TALKER).decide(PUT, IN, key)
        assert decision.where == Origin("router.json5", line)
        assert repr(name) in decision.reason
    unmentioned = model.on(TALKER).decide(QUERY, IN, "0/x")
    assert not unmentioned.allowed
    assert unmentioned.reason == "no rule for query ingress includes 0/x; the default is deny"


KEYS = st.sampled_from(["0/a", "0/b", "0/a/b", "0/@v", "0/*", "0/**", "**", "0/a$*"])


@given(
    st.lists(st.tuples(st.sampled_from(["allow", "deny"]), KEYS), min_size=1, max_size=5),
    st.randoms(use_true_random=False),
    KEYS,
)
def test_order_and_repetition_of_rules_mean_nothing(rules, randomly, key: str) -> None:
    ordered = [rule(str(number), effect, key_expr) for number, (effect, key_expr) in enumerate(rules)]
    shuffled = [*ordered, rule("again", *rules[0])]
    randomly.shuffle(shuffled)
    assert allowed(control(*ordered), key) == allowed(control(*shuffled), key)
