# SPDX-License-Identifier: Apache-2.0
"""Decision lists permit what is allowed and not denied, and contain nothing without effect."""

from __future__ import annotations

import itertools

from hypothesis import given, settings, strategies as st
from keymint_ros2_dds.compiling.arrangement import arrange, early_rules

from comarmor.patterns.glob import matches, parse
from comarmor.rules import PARTS, parts
from tests.effort import calls_of

WORDS = ["".join(word) for size in range(6) for word in itertools.product("ab", repeat=size)]
GLOBS = st.lists(st.sampled_from(["a", "b", "*", "?"]), max_size=4).map("".join).map(parse)
SETS = st.lists(GLOBS, max_size=4)


def anyone(globs, word):
    return any(matches(glob, word) for glob in globs)


def permitted(order, word):
    return anyone(order.free, word) or (not anyone(order.deny, word) and anyone(order.rest, word))


@settings(deadline=None)
@given(SETS, SETS)
def test_a_decision_list_permits_what_is_allowed_and_not_denied(allow, deny):
    order = arrange(allow, deny)
    for word in WORDS:
        assert permitted(order, word) == (anyone(allow, word) and not anyone(deny, word))
        assert not (anyone(order.free, word) and anyone(order.deny, word))
    assert bool(order.deny) == bool(order.rest)


@settings(deadline=None)
@given(SETS, SETS, SETS)
def test_what_must_be_mentioned_first(allow, deny, other):
    order = arrange(allow, deny)
    rescue = early_rules(other, order)
    for word in WORDS:
        early = anyone(order.free, word) or anyone(rescue.free, word)
        late = not anyone(rescue.deny, word) and anyone(rescue.rest, word)
        if anyone(other, word) and permitted(order, word):
            assert early or late
        if early or late:
            assert permitted(order, word)
        if anyone(rescue.deny, word):
            assert anyone(other, word)
            assert not permitted(order, word)


def test_rules_without_effect_are_left_out():
    allow = [parse(text) for text in ("/a", "/a*", "/b", "/b", "/secret", "/c?")]
    deny = [parse(text) for text in ("/secret", "/nothing", "/a1", "/a1*", "/c*")]
    order = arrange(allow, deny)
    assert order.free == (parse("/b"),)
    assert order.deny == (parse("/a1*"),)
    assert order.rest == (parse("/a*"),)


def test_a_thousand_literals_are_fast():
    allow = [parse(f"/ns{number}/topic") for number in range(1000)]
    deny = [parse(f"/ns{number}/topic") for number in range(0, 1000, 2)]
    order, calls = calls_of(lambda: arrange(allow, deny))
    assert len(order.free) == 500
    assert calls < 100 * len(allow)


def test_composites_stand_for_services_and_topics():
    assert parts("ros_topic", "ros_publish") == (("ros_topic", "ros_publish", ""),)
    assert {kind for listed in PARTS.values() for kind, _, _ in listed} == {"ros_topic", "ros_service"}
    assert ("ros_service", "ros_execute", "/_action/send_goal") in parts("ros_action", "ros_operate")
    assert len(parts("ros_parameter", "ros_read")) == 4
