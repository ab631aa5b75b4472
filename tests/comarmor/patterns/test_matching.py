# SPDX-License-Identifier: Apache-2.0
"""Matching agrees with the definition of a pattern, whatever its shape, and takes polynomial time."""

from __future__ import annotations

import re
from functools import cache

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from comarmor.patterns.glob import parse
from comarmor.patterns.matching import matcher, matches, regex
from comarmor.patterns.tokens import Star

TOKENS = ["a", "b", "ab", ".", "\n", "*", "?", "[ab]", "[!a]", "[b-a]", "[!b-a]", "[.-]"]
PATTERNS = st.lists(st.sampled_from(TOKENS), max_size=6).map("".join).map(parse)
NAMES = st.text("ab.\n-é", max_size=6)


@cache
def by_definition(pattern, name):
    """Return whether a pattern matches a name: try every length for each ``*``."""
    if not pattern:
        return not name
    token, *rest = pattern
    rest = tuple(rest)
    if isinstance(token, Star):
        return any(by_definition(rest, name[length:]) for length in range(len(name) + 1))
    if isinstance(token, str):
        return name.startswith(token) and by_definition(rest, name[len(token) :])
    return bool(name) and name[0] in token and by_definition(rest, name[1:])


@given(PATTERNS, NAMES)
@example(parse("ab*ba"), "aba")
@example(parse("a*a"), "a")
@example(parse("*ab*"), "b")
@example(parse("?"), "\n")
@example(parse("*a?*b"), "aab")
def test_every_shape_matches_by_definition(pattern, name):
    expected = by_definition(pattern, name)
    assert matches(pattern, name) is expected
    assert matcher(pattern)(name) is expected
    assert (re.fullmatch(regex(pattern), name, re.DOTALL) is not None) is expected


@pytest.mark.parametrize("pattern", ["*a" * 30 + "b", "*?a" * 30 + "*b", "*[ab]" * 30 + "c", "a*" * 30 + "b"])
def test_backtracking_does_not_explode(pattern):
    assert not matches(parse(pattern), "a" * 3000)
