# SPDX-License-Identifier: Apache-2.0
"""Universes contain the words of their fields, and budgets end a search."""

from __future__ import annotations

from collections import deque

import pytest
from hypothesis import given, strategies as st

from comarmor.patterns.decision_lists import EVERY_WORD, FAST_PATH_STEPS, BudgetError, SearchBudget, Universe
from comarmor.patterns.steps import step_limit
from comarmor.patterns.tokens import charset

AB = charset([(97, 98)])


@given(st.integers(1, 3), st.booleans(), st.text("ab\0-", max_size=6))
def test_a_word_belongs_to_the_universe_if_each_field_is_in_the_alphabet(fields, last_nonempty, word):
    parts = word.split("-")
    expected = len(parts) == fields and set("".join(parts)) <= {"a", "b"} and bool(parts[-1] or not last_nonempty)
    assert (word in Universe(AB, fields, "-", last_nonempty)) is expected


def test_every_word_is_every_string():
    for word in ("", "\n", "\0", "é\U0010ffff", "]^-\\"):
        assert word in EVERY_WORD


def test_characters_with_a_meaning_in_regular_expressions_are_ordinary():
    universe = Universe(charset([(ord("]"), ord("^")), (ord("-"), ord("-"))]), fields=2, separator=".")
    assert "]^-.-" in universe
    assert "]^-x-" not in universe
    assert "_." not in universe


def test_states_are_counted():
    count = SearchBudget(states=3).state_counter()
    for _ in range(3):
        count()
    with pytest.raises(BudgetError, match="not decided within 3 states"):
        count()
    other = SearchBudget(states=3).state_counter()
    other()


def test_a_deadline_is_asked_for_now_and_then():
    calls = []

    def go_on() -> bool:
        calls.append(1)
        return len(calls) < 3

    count = SearchBudget(go_on=go_on).state_counter()
    with pytest.raises(BudgetError, match="in time"):
        deque((count() for _ in range(100_000)), maxlen=0)
    assert len(calls) == 3


def test_a_state_costs_a_step_and_the_step_limit_grows_with_the_states():
    with step_limit(None) as counter:
        count = SearchBudget().state_counter()
        count()
        count()
    assert counter.spent == 2
    assert SearchBudget(10, steps_per_state=7).steps == FAST_PATH_STEPS + 70
