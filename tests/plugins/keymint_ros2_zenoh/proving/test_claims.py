# SPDX-License-Identifier: Apache-2.0
"""What a router's file permits is proven to be what the policy allows; each fault in it is found."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest
from hypothesis import given, settings
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
from keymint_ros2_zenoh.lowering.permissions import SLOTS, Place

from comarmor.errors import Origin
from keymint.api import Claim, Proof
from keymint.ir import SubjectRules
from tests.plugins.keymint_ros2_zenoh.lowering.policies import (
    NAMES,
    TYPED,
    policies,
    policy_allows,
    rule,
    subject_rules,
)

from .controls import FILE, claims_of, control_of, with_rules

NAME = "/robot1/talker"
BOTH = ["ros_publish", "ros_subscribe"]
RULES = subject_rules(
    rule("ALLOW", "ros_topic", BOTH, "/a*", "/b", line=1),
    rule("DENY", "ros_topic", BOTH, "/a/secret", line=2),
    rule("ALLOW", "ros_service", ["ros_call"], "/add", line=3),
    rule("ALLOW", "ros_service", ["ros_execute"], "/a/*", line=4),
    rule("ALLOW", "ros_parameter", ["ros_read"], "/other", line=5),
)


def claims(rules: SubjectRules, control: AccessControl, states: int = 100_000) -> list[Claim]:
    return claims_of(rules, NAME, control, states)


def refuted(control: AccessControl, rules: SubjectRules = RULES) -> dict[str, tuple[str, bool]]:
    """Return the refuted actions, each with the key and whether the router permits it."""
    found = {}
    for claim in claims(rules, control):
        assert claim.proof is not Proof.UNKNOWN, claim.reason
        if claim.counterexample is not None:
            example = claim.counterexample
            assert example.policy.allowed is not example.document.allowed
            assert example.endpoint.action == claim.action
            found[claim.action] = (example.endpoint.name, example.document.allowed)
    return found


def test_every_message_in_both_flows_is_proven() -> None:
    found = claims(RULES, control_of({NAME: RULES}))
    assert [claim.proof for claim in found] == [Proof.PROVEN] * 18
    assert len({claim.action for claim in found}) == 18


@settings(max_examples=25, deadline=None)
@given(policies())
def test_random_policies_are_proven(rules: SubjectRules) -> None:
    for claim in claims(rules, control_of({NAME: rules})):
        assert claim.proof is Proof.PROVEN, (claim.action, claim.reason, claim.counterexample)


@settings(max_examples=25, deadline=None)
@given(policies(), policies())
def test_the_rules_of_another_policy_are_refuted_where_they_differ(rules: SubjectRules, other: SubjectRules) -> None:
    found = refuted(control_of({NAME: other}), rules)
    if found:
        assert any(each.proof is not Proof.PROVEN for each in claims(rules, control_of({NAME: other})))
    else:  # a reply that the file cannot tell from another one is an exception of its own policy, not of another one
        own = {each.action for each in claims(rules, control_of({NAME: rules})) if each.excepted}
        assert refuted(control_of({NAME: rules}), other).keys() <= own


@settings(max_examples=20, deadline=None)
@given(policies())
def test_the_model_decides_on_each_name_as_the_policy(rules: SubjectRules) -> None:
    access = AccessModel(control_of({NAME: rules})).on(Link(NAME))
    for name in NAMES:
        for permission, slots in SLOTS.items():
            needed = {
                access.decide(
                    slot.message, slot.flow, f"0{name}/{TYPED}" + ("/@adv/**" if slot.place is Place.ADVANCED else "")
                ).allowed
                for slot in slots
            }
            assert (needed == {True}) is policy_allows(rules, permission, name), (permission, name)


def test_a_set_stands_for_characters_of_ros_names_in_the_engine_and_in_the_policy() -> None:
    """The router has the expressions of ``/a?b`` over these characters, while ``*`` stands for any text."""
    rules = subject_rules(rule("ALLOW", "ros_topic", BOTH, "/a?b", "/ab", line=1))
    assert refuted(control_of({NAME: subject_rules(rule("ALLOW", "ros_topic", BOTH, "/*a*b", line=1))}), rules)


def without(control: AccessControl, drop: Callable[[AclRule], bool]) -> AccessControl:
    gone = {each.id for each in control.rules if drop(each)}
    assert gone
    return replace(
        control,
        rules=tuple(each for each in control.rules if each.id not in gone),
        policies=tuple(
            replace(each, rules=tuple(name for name in each.rules if name not in gone)) for each in control.policies
        ),
    )


def drop_message(message: Message, permission: Permission) -> Callable[[AclRule], AclRule]:
    def change(each: AclRule) -> AclRule:
        if each.permission is not permission:
            return each
        return replace(each, messages=tuple(item for item in each.messages if item is not message))

    return change


SOUND = control_of({NAME: RULES})
SECRET = "0/a/secret/a/a"


def test_a_dropped_denial() -> None:
    found = refuted(without(SOUND, lambda each: each.permission is Permission.DENY))
    assert found["put in"] == found["put out"] == (SECRET, True)
    assert found["query in"] == (f"{SECRET}/@adv", True)


@pytest.mark.parametrize("message", [Message.PUT, Message.QUERY, Message.DECLARE_SUBSCRIBER])
def test_a_message_left_out_of_a_denial(message: Message) -> None:
    found = refuted(with_rules(SOUND, drop_message(message, Permission.DENY)))
    assert set(found) == {f"{message.replace('_', ' ')} {flow}" for flow in ("in", "out")}
    assert {permitted for _, permitted in found.values()} == {True}


def test_a_reply_left_out_of_a_denial() -> None:
    rules = subject_rules(
        rule("ALLOW", "ros_topic", BOTH, "/a/*"),
        rule("DENY", "ros_topic", BOTH, "/a/secret"),
    )
    found = refuted(with_rules(control_of({NAME: rules}), drop_message(Message.REPLY, Permission.DENY)), rules)
    assert found == {"reply in": (SECRET, True), "reply out": (SECRET, True)}


@pytest.mark.parametrize(
    ("message", "actions"),
    [
        (Message.PUT, {"put in", "put out"}),
        (Message.REPLY, {"reply in", "reply out"}),
        (Message.LIVELINESS_QUERY, {"liveliness query in"}),
        (Message.DECLARE_QUERYABLE, {"declare queryable in", "declare queryable out"}),
    ],
)
def test_a_message_left_out_of_what_is_allowed(message: Message, actions: set[str]) -> None:
    found = refuted(with_rules(SOUND, drop_message(message, Permission.ALLOW)))
    assert set(found) == actions
    assert {permitted for _, permitted in found.values()} == {False}


@pytest.mark.parametrize("permission", list(Permission))
def test_keys_beside_those_of_the_data_left_out(permission: Permission) -> None:
    def change(each: AclRule) -> AclRule:
        keys = tuple(key for key in each.key_exprs if each.permission is not permission or "@adv" not in key)
        return replace(each, key_exprs=keys)

    found = refuted(with_rules(SOUND, change))
    assert found["put in"][0].endswith("/@adv")
    assert {permitted for _, permitted in found.values()} == {permission is Permission.DENY}


def test_a_wildcard_subject() -> None:
    everyone = AclRule("all", (Message.PUT,), (Flow.INGRESS,), Permission.ALLOW, ("0/**",), Origin(FILE, 77))
    control = replace(
        SOUND,
        rules=(*SOUND.rules, everyone),
        subjects=(*SOUND.subjects, AclSubject("any")),
        policies=(*SOUND.policies, AclPolicy(("all",), ("any",))),
    )
    [claim] = [each for each in claims(RULES, control) if each.counterexample]
    assert claim.counterexample is not None
    assert claim.counterexample.endpoint.name == "0"
    assert claim.counterexample.document.where == Origin(FILE, 77)


def test_a_default_that_allows() -> None:
    found = refuted(replace(SOUND, default_permission=Permission.ALLOW))
    assert len(found) == 18
    assert {permitted for _, permitted in found.values()} == {True}


def test_access_control_that_is_off() -> None:
    assert len(refuted(replace(SOUND, enabled=False))) == 18


def test_another_common_name() -> None:
    found = refuted(control_of({"/robot1/talker2": RULES}))
    assert found["put in"] == ("0/a/a/a", False)


def test_the_tokens_of_another_enclave() -> None:
    def change(each: AclRule) -> AclRule:
        return replace(each, key_exprs=tuple(key.replace("%robot1%talker", "%robot$*") for key in each.key_exprs))

    [(action, (key, permitted))] = refuted(with_rules(SOUND, change)).items()
    assert (action, permitted) == ("liveliness token in", True)
    assert key.startswith("@ros2_lv/0/")


def test_another_domain() -> None:
    def change(each: AclRule) -> AclRule:
        return replace(each, key_exprs=(*each.key_exprs, *(f"1{key[1:]}" for key in each.key_exprs if key[:2] == "0/")))

    found = refuted(with_rules(SOUND, change))
    assert found["put in"][0].startswith("1/")


def test_a_counterexample_cites_the_policy_and_the_router() -> None:
    [claim] = [
        claim
        for claim in claims(RULES, without(SOUND, lambda each: each.permission is Permission.DENY))
        if claim.action == "put in"
    ]
    example = claim.counterexample
    assert example is not None
    assert example.meaning is not None
    assert (example.meaning.permission, example.meaning.object.name) == ("ros_publish", "/a/secret")
    assert example.policy.where == Origin("policy.xml", 2)
    assert example.document.where is not None
    assert example.document.where.file == FILE


def test_replies_that_one_list_cannot_separate_are_excepted() -> None:
    rules = subject_rules(
        rule("ALLOW", "ros_topic", ["ros_publish"], "/*"),
        rule("ALLOW", "ros_service", ["ros_execute"], "/x/get"),
        rule("DENY", "ros_topic", ["ros_publish"], "/x/*"),
    )
    found = {claim.action: claim for claim in claims(rules, control_of({NAME: rules}))}
    assert {claim.proof for claim in found.values()} == {Proof.PROVEN}
    assert [action for action, claim in found.items() if claim.excepted] == ["reply in"]


def test_subjects_that_depend_on_more_than_certificates() -> None:
    subjects = tuple(replace(each, interfaces=("eth0",)) for each in SOUND.subjects)
    assert {claim.proof for claim in claims(RULES, replace(SOUND, subjects=subjects))} == {Proof.UNKNOWN}


def test_too_few_states() -> None:
    found = claims(RULES, without(SOUND, lambda each: each.permission is Permission.DENY), states=5)
    assert any(claim.proof is Proof.UNKNOWN for claim in found)
    assert not any(claim.counterexample for claim in found)
