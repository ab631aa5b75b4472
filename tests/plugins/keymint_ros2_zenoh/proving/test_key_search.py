# SPDX-License-Identifier: Apache-2.0
"""The search finds a shortest key on which two sides differ, or proves that there is none."""

from __future__ import annotations

import re
from itertools import product

import pytest
from hypothesis import given, settings, strategies as st
from keymint_ros2_zenoh.keyexpr import KeyExpr, canonical, includes, parse
from keymint_ros2_zenoh.proving.key_search import Automaton, Side, difference, side_of

from comarmor.patterns.decision_lists import Equal, SearchBudget, Unknown, Witness
from tests.effort import tries

CHUNKS = ("a", "b", "ab", "*", "*", "**", "**", "$*a", "a$*", "a$*b", "$*ab$*a", "@a", "@a$*", "$*@a")
LEGAL = re.compile(r"[^@/]+(/[a-z][^/]*)*(/@[^/]*(/[^/]+)*)?|@[^/]*(/[^/]+)*")
KEYS = [
    "/".join(chunks)
    for size in (1, 2, 3)
    for chunks in product(("a", "b", "ab", "aba", "c", "@a", "a@a"), repeat=size)
    if LEGAL.fullmatch("/".join(chunks))
]

expressions = st.lists(st.sampled_from(CHUNKS), min_size=1, max_size=4).map("/".join).map(canonical)
entries = st.tuples(st.lists(expressions, max_size=3), st.lists(expressions, max_size=2))
sides = st.lists(entries, max_size=2)


def side_with(automaton: Automaton, entries_: list[tuple[list[KeyExpr], list[KeyExpr]]]) -> Side:
    return side_of(
        (frozenset(map(automaton.key_expr, allowed)), frozenset(map(automaton.key_expr, denied)))
        for allowed, denied in entries_
    )


def permits(entries_: list[tuple[list[KeyExpr], list[KeyExpr]]], key: str) -> bool:
    literal = parse(key)
    return any(
        any(includes(each, literal) for each in allowed) and not any(includes(each, literal) for each in denied)
        for allowed, denied in entries_
    )


def compared(left: list, right: list) -> Equal | Witness | Unknown:
    automaton = Automaton()
    return difference(automaton, side_with(automaton, left), side_with(automaton, right), SearchBudget(20_000))


@settings(max_examples=tries(75, 150), deadline=None)
@given(sides, sides)
def test_the_search_agrees_with_zenoh_on_all_short_keys(left: list, right: list) -> None:
    result = compared(left, right)
    differing = [key for key in KEYS if permits(left, key) is not permits(right, key)]
    if isinstance(result, Witness):
        assert permits(left, result.word) is result.left
        assert permits(right, result.word) is not result.left
        assert all(len(result.word) <= len(key) for key in differing)
    else:
        assert result == Equal()
        assert not differing


def lists(*texts: str) -> list[KeyExpr]:
    return [parse(text) for text in texts]


@pytest.mark.parametrize(
    ("left", "right"),
    [
        (["a/*", "a/*/*/**"], ["a/*/**"]),
        (["**/a", "**/$*a"], ["**/$*a"]),
        (["*/**/b"], ["*/b", "*/*/**/b"]),
        (["@a$*"], []),
    ],
)
def test_different_expressions_for_the_same_keys(left: list[str], right: list[str]) -> None:
    assert compared([(lists(*left), [])], [(lists(*right), [])]) == Equal()


def test_a_difference_far_from_the_beginning() -> None:
    left = [(lists("0/**"), lists("0/a/**/secret"))]
    right = [(lists("0/**"), [])]
    assert compared(left, right) == Witness("0/a/secret", left=False)


def test_what_one_entry_denies_another_may_allow() -> None:
    denied = (lists("0/**"), lists("0/x"))
    assert compared([denied, (lists("0/x"), [])], [(lists("0/**"), [])]) == Equal()
    assert compared([denied], [(lists("0/**"), [])]) == Witness("0/x", left=False)


def test_everything() -> None:
    automaton = Automaton()
    all_of_it = frozenset((automaton.everything,))
    keys = frozenset((automaton.key_expr(parse("**")),))
    result = difference(
        automaton, side_of(((all_of_it, frozenset()),)), side_of(((keys, frozenset()),)), SearchBudget(1000)
    )
    assert result == Witness("@", left=True)


def test_the_budget() -> None:
    automaton = Automaton()
    left = side_with(automaton, [(lists("a$*b$*a/**/b"), [])])
    right = side_with(automaton, [(lists("a$*a$*a/**/b"), [])])
    assert isinstance(difference(automaton, left, right, SearchBudget(3)), Unknown)
    assert isinstance(difference(automaton, left, right, SearchBudget(500, go_on=lambda: False)), Unknown)
    assert isinstance(difference(automaton, left, right, SearchBudget(500)), Witness)
