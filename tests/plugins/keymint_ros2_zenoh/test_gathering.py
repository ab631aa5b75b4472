# SPDX-License-Identifier: Apache-2.0
"""Fewer rules decide every message and key expression as all of them do."""

from __future__ import annotations

from hypothesis import given, strategies as st
from keymint_ros2_zenoh.documents.configuration import AclRule, Flow, Message, Permission
from keymint_ros2_zenoh.keyexpr import KeyExpr, canonical, includes, parse
from keymint_ros2_zenoh.lowering.key_rules import combined_rules

CHUNKS = st.sampled_from(["a", "b", "*", "**", "a$*", "@adv"])
KEYS = st.lists(CHUNKS, min_size=1, max_size=4).map(lambda chunks: canonical("/".join(chunks)))
RULES = st.builds(
    AclRule,
    st.just(""),
    st.sampled_from([(Message.PUT,), (Message.PUT, Message.QUERY), (Message.REPLY,)]),
    st.sampled_from([(Flow.INGRESS,), tuple(Flow)]),
    st.sampled_from(Permission),
    st.lists(KEYS.map(str), min_size=1, max_size=4).map(tuple),
)


def decision(rules: tuple[AclRule, ...], message: Message, flow: Flow, key: KeyExpr) -> bool:
    applying = {
        rule.permission
        for rule in rules
        if message in rule.messages and flow in rule.flows and any(includes(parse(own), key) for own in rule.key_exprs)
    }
    return applying == {Permission.ALLOW}


@given(st.lists(RULES, max_size=6).map(tuple), st.lists(KEYS, min_size=1, max_size=8))
def test_every_decision_is_the_same(rules: tuple[AclRule, ...], keys: list[KeyExpr]) -> None:
    fewer = combined_rules(rules)
    assert len(fewer) <= len(rules)
    for key in keys:
        for message in (Message.PUT, Message.QUERY, Message.REPLY):
            for flow in Flow:
                assert decision(fewer, message, flow, key) == decision(rules, message, flow, key)


def test_included_key_expressions_are_left_out() -> None:
    keys = [("0/a/*/*", "0/b/*/*"), ("0/**",)]
    rules = [AclRule("", (Message.PUT,), (Flow.INGRESS,), Permission.ALLOW, each) for each in keys]
    [one] = combined_rules(rules)
    assert one.key_exprs == ("0/**",)
