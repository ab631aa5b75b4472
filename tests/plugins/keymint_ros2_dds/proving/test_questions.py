# SPDX-License-Identifier: Apache-2.0
"""The evaluator of policies against a second one, written down without the code under test."""

from __future__ import annotations

import itertools

import pytest
from hypothesis import given, settings, strategies as st
from keymint_ros2_dds.proving.questions import deciding_rule, is_ros_name

from comarmor.rules import Effect
from keymint.ir import SubjectRules
from tests.effort import tries
from tests.plugins.keymint_ros2_dds.compiling.test_grant_compiler import DENIED, FEW, PARTITIONS, rules
from tests.plugins.keymint_ros2_dds.oracles import policy
from tests.plugins.keymint_ros2_dds.packages import rule


@settings(max_examples=tries(30, 60), deadline=None)
@given(st.lists(st.one_of(rules(), rules(PARTITIONS), rules(DENIED)), max_size=4))
def test_it_decides_as_the_language_says(drawn) -> None:
    given_rules = SubjectRules("/s", tuple(drawn))
    for action, topic, partition in itertools.product(("publish", "subscribe"), FEW, ("", "p", "r")):
        found = deciding_rule(given_rules, "humble", action, topic, partition)
        allowed = found is not None and found.effect is Effect.ALLOW
        assert allowed == policy(given_rules, action, topic, (partition,)), (action, topic, partition)


def test_the_first_denial_decides_else_the_first_match() -> None:
    allow, again = rule("ALLOW", "topic", "publish", "*", line=1), rule("ALLOW", "topic", "publish", "x", line=2)
    deny, last = rule("DENY", "topic", "publish", "x", line=3), rule("DENY", "topic", "publish", "x*", line=4)
    assert deciding_rule(SubjectRules("/s", (allow, again)), "humble", "publish", "x", "") == allow
    assert deciding_rule(SubjectRules("/s", (allow, again, deny, last)), "humble", "publish", "x", "") == deny
    assert deciding_rule(SubjectRules("/s", (again,)), "humble", "publish", "y", "") is None


@pytest.mark.parametrize(
    ("name", "legal"), [("/a", True), ("/a/b_1", True), ("a", False), ("/a//b", False), ("/a__b", False), ("/1", False)]
)
def test_names_that_a_topic_may_have(name: str, legal: bool) -> None:
    assert is_ros_name(name) is legal
