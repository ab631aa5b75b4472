# SPDX-License-Identifier: Apache-2.0
"""Derivatives accept what their patterns match, and the inclusion test is sound.

The search of a cube returns a shortest word that all positive and no excluded patterns match.
"""

from __future__ import annotations

import pytest
from hypothesis import given, settings, strategies as st

from comarmor.patterns.decision_lists import BudgetError, SearchBudget
from comarmor.patterns.derivatives import CubeSearch, Derivatives
from comarmor.patterns.glob import matches, parse
from tests.effort import tries

from .small import UNIVERSE, WORDS, globs


@settings(max_examples=tries(60, 300), deadline=None)
@given(globs)
def test_a_word_is_accepted_if_its_derivative_accepts(pattern):
    derivatives = Derivatives((pattern,), UNIVERSE)
    for word in WORDS[:63]:
        nodes = frozenset((derivatives.node(pattern),))
        for letter in word:
            nodes = derivatives.steps(nodes, letter)
        assert any(derivatives.accepts[node] for node in nodes) == matches(pattern, word)


@settings(max_examples=tries(100, 600), deadline=None)
@given(globs, globs)
def test_inclusion_is_sound(outer, inner):
    derivatives = Derivatives((outer, inner), UNIVERSE)
    if derivatives.includes(derivatives.node(outer), derivatives.node(inner)):
        assert all(matches(outer, word) for word in WORDS if matches(inner, word))


def test_inclusion_is_found_between_ordinary_patterns():
    for wide, narrow in (("rt/*", "rt/x*"), ("*a", "*ba"), ("*", "a?"), ("a*b", "a?b")):
        derivatives = Derivatives((parse(wide), parse(narrow)), UNIVERSE)
        assert derivatives.includes(derivatives.node(parse(wide)), derivatives.node(parse(narrow)))
        assert not derivatives.includes(derivatives.node(parse(narrow)), derivatives.node(parse(wide)))


def search(positives, excluded, budget=None, limit=None):
    derivatives = Derivatives((*positives, *excluded), UNIVERSE)
    count_state = (budget or SearchBudget()).state_counter()
    return CubeSearch(derivatives, positives, excluded, count_state).shortest(limit)


def in_cube(word, positives, excluded):
    return all(matches(each, word) for each in positives) and not any(matches(each, word) for each in excluded)


CUBES = st.tuples(st.lists(globs, min_size=1, max_size=3), st.lists(globs, max_size=4))


@settings(max_examples=tries(60, 250), deadline=None)
@given(CUBES)
def test_the_word_is_a_shortest_of_the_cube(cube):
    first = next((word for word in WORDS if in_cube(word, *cube)), None)
    word = search(*cube)
    if word is None:
        assert first is None
    else:
        assert in_cube(word, *cube)
        assert len(word) > len(WORDS[-1]) if first is None else len(word) == len(first)


@settings(max_examples=tries(60, 200), deadline=None)
@given(CUBES, st.integers(0, 4))
def test_only_words_shorter_than_the_limit_count(cube, limit):
    unlimited, word = search(*cube), search(*cube, limit=limit)
    if unlimited is not None and len(unlimited) < limit:
        assert word is not None
        assert len(word) == len(unlimited)
    else:
        assert word is None


def test_a_spent_budget_ends_the_search():
    hard = [parse(f"*{'?' * size}a{'?' * (9 - size)}") for size in range(10)]
    with pytest.raises(BudgetError, match="within 20 states"):
        search([parse("*" + "?" * 10)], hard, SearchBudget(20))
    assert search([parse("*" + "?" * 10)], hard) == "b" * 10
