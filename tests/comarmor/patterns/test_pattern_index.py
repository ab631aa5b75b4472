# SPDX-License-Identifier: Apache-2.0
"""The index returns the same patterns as a comparison of all pairs."""

from __future__ import annotations

from hypothesis import given, settings, strategies as st

from comarmor.patterns.glob import matches
from comarmor.patterns.pattern_index import PatternIndex
from comarmor.patterns.relations import disjoint
from tests.effort import tries

from .small import globs

PATTERNS = st.lists(globs, max_size=12, unique=True)


@settings(max_examples=tries(60, 300), deadline=None)
@given(PATTERNS, st.text(alphabet="ab", max_size=5))
def test_patterns_that_match_a_word(patterns, word):
    index = PatternIndex((pattern, number) for number, pattern in enumerate(patterns))
    expected = {number for number, pattern in enumerate(patterns) if matches(pattern, word)}
    assert sorted(number for _, number in index.matching(word)) == sorted(expected)


@settings(max_examples=tries(60, 300), deadline=None)
@given(PATTERNS, globs)
def test_patterns_that_meet_a_pattern(patterns, other):
    index = PatternIndex((pattern, number) for number, pattern in enumerate(patterns))
    expected = [number for number, pattern in enumerate(patterns) if not disjoint(pattern, other)]
    assert sorted(number for _, number in index.meeting(other)) == expected
    assert {number for _, number in index.candidates(other)} >= set(expected)
    assert list(index) == list(zip(patterns, range(len(patterns)), strict=True))
