# SPDX-License-Identifier: Apache-2.0
"""The algebra of expressions, against all words over a small alphabet."""

from __future__ import annotations

import itertools
from functools import lru_cache

import pytest
from hypothesis import example, given, settings, strategies as st

from comarmor.patterns import glob
from comarmor.patterns.glob import EVERYTHING, matches, parse
from comarmor.patterns.relations import (
    TooComplexError,
    all_disjoint,
    covers,
    disjoint,
    intersection,
    maximal,
    union_covers,
)
from tests.effort import calls_of

WORDS = ["".join(word) for size in range(7) for word in itertools.product("abc", repeat=size)]
GLOBS = st.lists(st.sampled_from(["a", "b", "*", "?", "[ab]", "[!a]"]), max_size=4).map("".join).map(parse)


unhurried = settings(deadline=None)  # the first example builds caches


@lru_cache(maxsize=4096)
def language(each):
    return frozenset(word for word in WORDS if matches(each, word))


def words(*globs):
    """The words of up to six letters that any of some globs matches: enough for patterns of four tokens."""
    return frozenset().union(*map(language, globs))


@unhurried
@given(GLOBS, GLOBS)
@example(parse("a*"), parse("*b"))
@example(parse("*a?"), parse("?b*"))
def test_disjoint(left, right):
    assert disjoint(left, right) == (not words(left) & words(right))


@unhurried
@given(GLOBS, GLOBS)
@example(parse("a*b"), parse("ab"))
@example(parse("a*a"), parse("a"))
@example(parse("a*a"), parse("?*?"))
def test_covers(outer, inner):
    assert covers(outer, inner) == (words(inner) <= words(outer))


@unhurried
@given(st.lists(GLOBS, max_size=4).map(tuple), GLOBS)
@example((parse("a*"), parse("[!a]*"), ()), EVERYTHING)
@example((parse("a*"), parse("b*")), parse("?*"))
def test_union_covers(outers, inner):
    assert union_covers(outers, inner) == (words(inner) <= words(*outers))


@unhurried
@given(GLOBS, GLOBS)
@example(parse("*ab*"), parse("*ba*"))
@example(parse("a*"), parse("*a"))
def test_intersection(left, right):
    assert words(*intersection(left, right)) == words(left) & words(right)


@unhurried
@given(st.lists(GLOBS, max_size=5))
def test_maximal_keeps_the_union_and_nothing_that_another_covers(globs):
    kept = maximal(globs)
    assert words(*kept) == words(*globs)
    assert not [pair for pair in itertools.permutations(kept, 2) if covers(*pair)]


def test_an_empty_set_is_covered_by_all_and_meets_none():
    nothing = parse("x[b-a]")
    assert glob.is_empty(nothing)
    assert covers(parse("q"), nothing)
    assert disjoint(EVERYTHING, nothing)
    assert not covers(nothing, parse("x"))


def test_too_many_states_mean_unknown():
    assert union_covers((parse("*a?"), parse("*")), parse("*b*"))
    hard = tuple(parse(each) for each in ("*a" + "?" * 12, f"*[!a]{'?' * 11}z", f"*[!a]{'?' * 11}[!z]"))
    assert not union_covers(hard, parse("?" * 13 + "*"))  # though the letter there is an "a", or it is not


def test_a_pattern_that_is_among_others_is_covered_without_a_search():
    hard = tuple(parse(f"*{'?' * size}a{'?' * (12 - size)}") for size in range(12))
    assert union_covers(hard, parse("*a" + "?" * 12))


def test_too_many_pieces_are_refused():
    with pytest.raises(TooComplexError):
        intersection(parse("*a*b*c*d*"), parse("*d*c*b*a*"), 8)


def test_long_hostile_expressions_end_soon():
    left, right = parse("*a" * 60 + "*"), parse("*b" * 60 + "*")
    found, calls = calls_of(lambda: (disjoint(left, right), covers(left, right)))
    assert found == (False, False)
    assert calls < 1_000_000


@unhurried
@given(st.lists(GLOBS, max_size=4), st.lists(GLOBS, max_size=4))
def test_lists_are_disjoint_when_all_of_their_pairs_are(lefts, rights):
    assert all_disjoint(lefts, rights) is all(disjoint(left, right) for left in lefts for right in rights)
