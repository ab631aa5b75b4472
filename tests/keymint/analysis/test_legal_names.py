# SPDX-License-Identifier: Apache-2.0
"""Whether a literal name is legal is the same by its form and by the proof engine."""

from __future__ import annotations

from hypothesis import example, given, strategies as st

from comarmor.errors import Origin
from comarmor.patterns.decision_lists import Equal
from comarmor.patterns.glob import parse
from comarmor.rules import Effect, Rule
from keymint.analysis.redundant_rules import can_name_exist
from keymint.analysis.rule_lists import allow_only, find_permitted


@given(st.text("/a1_.Z é", max_size=6))
@example("/")
@example("/a/1")
def test_a_literal_name_is_legal_as_the_engine_says(name: str) -> None:
    rule = Rule(Effect.ALLOW, "ros_topic", ("ros_publish",), (name,), (), False, Origin("policy.xml", 1))
    expected = not isinstance(find_permitted("ros_topic", allow_only(parse(name))), Equal)
    assert can_name_exist(rule, name) == expected
