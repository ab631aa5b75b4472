# SPDX-License-Identifier: Apache-2.0
"""A rule applies to objects and partitions that its expressions match, and to the parts of composite permissions."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from comarmor.errors import Origin
from comarmor.patterns.rule_matching import rule_matches, rule_matches_partition
from comarmor.rules import PARTS, Effect, Rule, parts


def rule(kind, permissions, *expressions, effect=Effect.ALLOW, partitions=()):
    return Rule(effect, kind, permissions, expressions, partitions, False, Origin("policy.xml", 1))


def test_a_rule_applies_to_objects_of_its_kind_that_any_expression_matches():
    topics = rule("ros_topic", ("ros_publish",), "/a", "/b*")
    assert rule_matches(topics, "ros_topic", "ros_publish", "/a")
    assert rule_matches(topics, "ros_topic", "ros_publish", "/bc")
    assert not rule_matches(topics, "ros_topic", "ros_publish", "/c")
    assert not rule_matches(topics, "ros_topic", "ros_subscribe", "/a")
    assert not rule_matches(topics, "topic", "publish", "/a")


@given(st.sampled_from(sorted(PARTS)), st.sampled_from(["/a", "/b", "/a/b"]), st.sampled_from(["/a", "/a*", "*", "/?"]))
def test_a_composite_rule_applies_to_exactly_the_parts_of_the_objects_it_applies_to(composite, name, expression):
    kind, permission = composite
    granted = rule(kind, (permission,), expression)
    implemented = {(k, p, name + suffix) for k, p, suffix in parts(kind, permission)}
    every_part = {(k, p, name + suffix) for each in PARTS.values() for k, p, suffix in each}
    for part in every_part:
        applies = part in implemented and rule_matches(granted, kind, permission, name)
        assert rule_matches(granted, *part) is applies


def test_an_expression_matches_the_name_before_the_suffix_of_a_part():
    reads = rule("ros_parameter", ("ros_read",), "/n")
    assert rule_matches(reads, "ros_service", "ros_call", "/n/get_parameters")
    assert not rule_matches(reads, "ros_service", "ros_call", "/n/get_parameters/get_parameters")
    assert not rule_matches(reads, "ros_service", "ros_execute", "/n/get_parameters")
    assert not rule_matches(reads, "ros_service", "ros_call", "/n/set_parameters")


@pytest.mark.parametrize("effect", Effect)
@pytest.mark.parametrize(
    ("partitions", "matched", "unmatched"),
    [(("p*", ""), {"", "p", "px"}, {"q"}), (("",), {""}, {"p"}), (("*",), {"", "p"}, set())],
)
def test_partitions_of_a_rule(effect, partitions, matched, unmatched):
    raw = rule("topic", ("publish",), "t", effect=effect, partitions=partitions)
    assert {each for each in matched | unmatched if rule_matches_partition(raw, each)} == matched


def test_a_rule_without_partitions_allows_the_default_one_and_denies_all():
    assert rule_matches_partition(rule("topic", ("publish",), "t"), "")
    assert not rule_matches_partition(rule("topic", ("publish",), "t"), "p")
    assert rule_matches_partition(rule("topic", ("publish",), "t", effect=Effect.DENY), "p")
