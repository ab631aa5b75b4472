# SPDX-License-Identifier: Apache-2.0
"""The product search returns a shortest word on which a conjunction of lists and another list differ."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from comarmor.patterns.decision_lists import BudgetError, Equal, SearchBudget, Witness
from comarmor.patterns.derivatives import Derivatives
from comarmor.patterns.evaluate import permits
from comarmor.patterns.product_search import ProductSearch
from comarmor.patterns.proofs import difference
from tests.effort import tries

from .small import UNIVERSE, WORDS, allow, deny, first_difference, lists, patterns_of


def search(together, other, *, universe=UNIVERSE, budget=None):
    derivatives = Derivatives(patterns_of(*together, other), universe)
    return ProductSearch(together, other, universe, derivatives, (budget or SearchBudget()).state_counter()).shortest()


@settings(max_examples=tries(60, 200), deadline=None)
@given(st.lists(lists, min_size=1, max_size=3), lists)
def test_the_word_is_a_shortest_difference(together, other):
    first = first_difference(other, *together)
    word = search(together, other)
    if word is None:
        assert first is None
    else:
        assert permits(other, word) is not all(permits(each, word) for each in together)
        assert len(word) > len(WORDS[-1]) if first is None else len(word) == len(first)


@settings(max_examples=tries(60, 200), deadline=None)
@given(lists, lists)
def test_an_empty_last_field_does_not_count_if_the_universe_excludes_it(a, b):
    word = search((b,), a, universe=replace(UNIVERSE, last_nonempty=True))
    expected = next((word for word in WORDS if word and permits(a, word) is not permits(b, word)), None)
    assert word != ""
    assert (word is None or len(word) > len(WORDS[-1])) if expected is None else len(word or "") == len(expected)


def test_a_literal_decides_its_word_without_hiding_longer_ones():
    assert search(((deny("ab"), allow("a*")),), (allow("a*"),)) == "ab"
    assert search(((deny("a"), allow("a*")),), (deny("a"), allow("a", "ab*"))) == "aa"


def test_a_spent_budget_ends_the_search():
    far = tuple(f"*a{'?' * size}" for size in range(8))
    with pytest.raises(BudgetError, match="within 10 states"):
        search(((allow(*far),),), (allow(*far, "*b" + "?" * 8),), budget=SearchBudget(10))


@settings(max_examples=tries(60, 200), deadline=None)
@given(lists, lists, lists)
def test_the_engines_agree(a, b, c):
    found = difference(a, b, c, universe=UNIVERSE)
    derivatives = Derivatives(patterns_of(a, b, c), UNIVERSE)
    other = ProductSearch((b, c), a, UNIVERSE, derivatives, SearchBudget().state_counter()).shortest()
    assert (other is None) == isinstance(found, Equal)
    if isinstance(found, Witness):
        assert other is not None
        assert len(other) == len(found.word)
