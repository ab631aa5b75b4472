# SPDX-License-Identifier: Apache-2.0
"""Fewer rules decide every message and key expression as all of them do."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st
from keymint_ros2_zenoh.keyexpr.key_expr import KeyExpr, canonical
from keymint_ros2_zenoh.keyexpr.key_relations import includes
from keymint_ros2_zenoh.lowering.key_rules import KeyRule, combined_rules
from keymint_ros2_zenoh.messages import Flow, Message

from comarmor.rules import Effect

CHUNKS = st.sampled_from(["a", "b", "*", "**", "a$*", "@adv"])
KEYS = st.lists(CHUNKS, min_size=1, max_size=4).map(lambda chunks: canonical("/".join(chunks)))
RULES = st.builds(
    KeyRule,
    st.sampled_from(Effect),
    st.sampled_from([(Message.PUT,), (Message.PUT, Message.QUERY), (Message.REPLY,)]),
    st.sampled_from([(Flow.INGRESS,), tuple(Flow)]),
    st.lists(KEYS, min_size=1, max_size=4).map(tuple),
)


def decision(rules: tuple[KeyRule, ...], message: Message, flow: Flow, key: KeyExpr) -> bool:
    applying = {
        rule.effect
        for rule in rules
        if message in rule.messages and flow in rule.flows and any(includes(own, key) for own in rule.key_exprs)
    }
    return applying == {Effect.ALLOW}


@given(st.lists(RULES, max_size=6).map(tuple), st.lists(KEYS, min_size=1, max_size=8))
def test_every_decision_is_the_same(rules: tuple[KeyRule, ...], keys: list[KeyExpr]) -> None:
    fewer = combined_rules(rules)
    assert len(fewer) <= len(rules)
    for key in keys:
        for message in (Message.PUT, Message.QUERY, Message.REPLY):
            for flow in Flow:
                assert decision(fewer, message, flow, key) == decision(rules, message, flow, key)


def test_included_key_expressions_are_left_out() -> None:
    keys = [(canonical("0/a/*/*"), canonical("0/b/*/*")), (canonical("0/**"),)]
    rules = [KeyRule(Effect.ALLOW, (Message.PUT,), (Flow.INGRESS,), each) for each in keys]
    [one] = combined_rules(rules)
    assert one.key_exprs == (canonical("0/**"),)
