# SPDX-License-Identifier: Apache-2.0
"""The search over cubes returns a shortest word that all of some lists permit and another one denies."""

from __future__ import annotations

import pytest
from hypothesis import given, settings, strategies as st

from comarmor.patterns.counterexample_search import ROUNDS, CounterexampleSearch
from comarmor.patterns.decision_lists import BudgetError, SearchBudget
from comarmor.patterns.derivatives import Derivatives
from comarmor.patterns.evaluate import permits
from tests.effort import tries

from .small import PRINTABLE, UNIVERSE, WORDS, allow, deny, lists, patterns_of


def search(permitting, denying, *, universe=UNIVERSE, budget=None, limit=None):
    return CounterexampleSearch(
        permitting,
        denying,
        universe,
        lambda: Derivatives(patterns_of(*permitting, denying), universe),
        (budget or SearchBudget()).state_counter(),
    ).shortest(limit)


def is_counterexample(word, permitting, denying):
    return all(permits(each, word) for each in permitting) and not permits(denying, word)


@settings(max_examples=tries(60, 200), deadline=None)
@given(st.lists(lists, min_size=1, max_size=3), lists)
def test_the_word_is_a_shortest_counterexample(permitting, denying):
    first = next((word for word in WORDS if is_counterexample(word, permitting, denying)), None)
    word = search(permitting, denying)
    if word is None:
        assert first is None
    else:
        assert is_counterexample(word, permitting, denying)
        assert len(word) > len(WORDS[-1]) if first is None else len(word) == len(first)


@settings(max_examples=tries(60, 200), deadline=None)
@given(st.lists(lists, min_size=1, max_size=2), lists, st.integers(0, 4))
def test_only_words_shorter_than_the_limit_count(permitting, denying, limit):
    unlimited, word = search(permitting, denying), search(permitting, denying, limit=limit)
    if unlimited is not None and len(unlimited) < limit:
        assert word is not None
        assert len(word) == len(unlimited)
    else:
        assert word is None


def test_derivatives_are_not_needed_for_literals():
    def unneeded() -> Derivatives:
        raise AssertionError("no cube is to be searched")

    count_state = SearchBudget().state_counter()
    literals = (allow("x", "yy"),)
    assert CounterexampleSearch([literals], (allow("x"),), PRINTABLE, unneeded, count_state).shortest() == "yy"
    assert CounterexampleSearch([literals], literals, PRINTABLE, unneeded, count_state).shortest() is None


def test_a_cube_with_many_excluded_patterns_is_searched_to_its_end():
    # Each round returns a word of one letter that one more pattern excludes; there are more letters than rounds.
    letters = "abcdefghijklmnopqrstuvwxyz"
    assert len(letters) > ROUNDS
    excluding = deny(*(f"{letter}*" for letter in letters))
    assert search([(excluding, allow("[a-z]*"))], (), universe=PRINTABLE) is None
    assert search([(deny(*(f"{letter}*" for letter in letters[:-1])), allow("[a-z]*"))], (), universe=PRINTABLE) == "z"


def test_a_spent_budget_ends_the_search():
    with pytest.raises(BudgetError):
        search([(allow("*a*b*"),)], (allow("*ab*"),), budget=SearchBudget(2))
