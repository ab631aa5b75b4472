# SPDX-License-Identifier: Apache-2.0
"""A pattern matches a ROS name or not, exactly; and the advice on what to write instead."""

from __future__ import annotations

import re
from itertools import product

import pytest
from hypothesis import example, given, strategies as st

from comarmor.patterns.glob import matches, parse
from comarmor.patterns.possible_names import advice, matches_ros_name
from comarmor.rules import is_fully_qualified

NAMES = [name for size in range(7) for name in map("".join, product("/a0", repeat=size)) if is_fully_qualified(name)]
"""All names of up to six characters over an alphabet that has one of each kind."""
PATTERNS = st.lists(st.sampled_from(["/", "a", "0", "*", "?", "[/0]", "[!/]", "-"]), max_size=4).map("".join).map(parse)


@given(PATTERNS)
@example(parse("[!a-z]"))
@example(parse("//*"))
@example(parse("*/"))
@example(parse("?[/0][!/]"))
def test_a_pattern_matches_a_ros_name_exactly_if_one_exists(pattern):
    assert matches_ros_name(pattern) is any(matches(pattern, name) for name in NAMES)


@pytest.mark.parametrize(
    ("expression", "correction"),
    [
        ("~/scan", "{namespace}{name}/scan"),
        ("/~/scan", "{namespace}{name}/scan"),
        ("~", "write the node's full name, {namespace}{name}"),
        ("rt/x", "write '/x'"),
        ("rq/svcRequest", "kind 'topic'"),
        ("/rover/(scan|odom)", "<attachment> for each"),
        ("/rover/scan.raw", "segments are"),
        ("/rover/.*", "write '/rover/*'"),
        ("/rover/my-scan", "write '/rover/my_scan'"),
        ("scan", "write '/scan': every ROS name begins with '/'"),
        ("/a//b", "write '/a/b'"),
        ("/a/", "write '/a'"),
        ("/1st", "begin with a digit"),
        ("a\\", "segments are"),
    ],
)
def test_advice(expression, correction):
    text = advice(expression)
    assert correction in text
    assert "\n" not in text


@given(st.text("/a0-*.~", max_size=6))
def test_an_expression_that_the_advice_proposes_can_match(expression):
    proposed = re.fullmatch(r"write '([^']*)'(: every ROS name begins with '/')?", advice(expression))
    if proposed and not matches_ros_name(parse(expression)):
        assert matches_ros_name(parse(proposed[1]))
