# SPDX-License-Identifier: Apache-2.0
"""Comparisons agree with the definition on all small words."""

from __future__ import annotations

import itertools
from dataclasses import replace

import pytest
from hypothesis import given, settings, strategies as st

from comarmor.patterns.counterexample_search import ProductSearch
from comarmor.patterns.decision_lists import (
    EVERY_WORD,
    BudgetError,
    Equal,
    SearchBudget,
    Universe,
    Unknown,
    Witness,
)
from comarmor.patterns.derivatives import Derivatives
from comarmor.patterns.evaluate import permits
from comarmor.patterns.glob import parse
from comarmor.patterns.proofs import difference, escapes
from tests.effort import tries

from .small import PRINTABLE, UNIVERSE, WORDS, allow, deny, first_difference, lists, patterns_of


def agrees(found: object, first: str | None) -> bool:
    """Return whether a result is right, given the first small word that is a witness."""
    if isinstance(found, Equal):
        return first is None
    assert isinstance(found, Witness)
    return len(found.word) > len(WORDS[-1]) if first is None else len(found.word) == len(first)


@settings(max_examples=tries(100, 600), deadline=None)
@given(lists, lists)
def test_difference_is_found_with_a_shortest_word(a, b):
    found = difference(a, b, universe=UNIVERSE)
    assert agrees(found, first_difference(a, b))
    if isinstance(found, Witness):
        assert permits(a, found.word) is found.left
        assert permits(b, found.word) is not found.left


@settings(max_examples=tries(60, 300), deadline=None)
@given(lists, lists, lists)
def test_a_list_is_compared_with_a_conjunction(a, b, c):
    assert agrees(difference(a, b, c, universe=UNIVERSE), first_difference(a, b, c))


@settings(max_examples=tries(60, 300), deadline=None)
@given(lists, lists)
def test_implication_and_intersection(a, b):
    escaping = next((word for word in WORDS if permits(a, word) and not permits(b, word)), None)
    assert agrees(escapes([a], b, UNIVERSE), escaping)
    common = next((word for word in WORDS if permits(a, word) and permits(b, word)), None)
    assert agrees(escapes((a, b), (), UNIVERSE), common)


def test_rewritten_lists_are_equal():
    assert difference((allow("rt/*"),), (allow("rt/", "rt/?*"),)) == Equal()
    assert difference((deny("a*b"), allow("a*")), (deny("ab", "a?*b"), allow("a", "a?*"))) == Equal()
    assert difference((), (deny("*"), allow("x"))) == Equal()


def test_the_first_step_that_matches_decides():
    found = difference((deny("secret"), allow("s*")), (allow("s*"), deny("secret")))
    assert found == Witness("secret", left=False)


def test_what_a_sloppy_image_lets_in_shows_itself():
    found = difference((allow("rt/scan", "rt/*/scan"),), (allow("rt*/scan"),), universe=PRINTABLE)
    assert isinstance(found, Witness)
    assert found.left is False
    assert len(found.word) == len("rtx/scan")


@pytest.mark.parametrize(("outer", "inner"), [("[a-c]", "[!d-z]"), ("a[!x]", "a?"), ("[é]", "?")])
def test_sets_of_characters(outer, inner):
    assert isinstance(difference((allow(outer),), (allow(inner),)), Witness)
    assert escapes([(allow(outer),)], (allow("*"),)) == Equal()


def test_the_universe_bounds_the_question():
    a, b = (allow("[a-z]"),), (allow("?"),)
    small = Universe(parse("[a-z]")[0])
    assert difference(a, b, universe=small) == Equal()
    assert isinstance(difference(a, b, universe=EVERY_WORD), Witness)


def test_words_of_two_fields_cannot_run_into_each_other():
    pairs = Universe(PRINTABLE.alphabet, fields=2)
    a = (allow("p*\0x", "q\0*"),)
    assert difference(a, (allow("p\0x", "p?*\0x", "q\0", "q\0?*"),), universe=pairs) == Equal()
    merged = difference((allow("a\0x", "b\0y"),), (allow("a\0x", "b\0y", "a\0y", "b\0x"),), universe=pairs)
    assert isinstance(merged, Witness)
    assert merged.word in {"a\0y", "b\0x"}
    assert not merged.left


def test_a_character_of_a_pattern_without_effect_is_distinguished():
    # A last denial changes nothing, but the alphabet is made of all patterns.
    assert difference((allow("a*"), deny("*q*")), (allow("a*"),)) == Equal()


@pytest.mark.parametrize("states", [0, 5, 50])
def test_a_spent_budget_is_unknown(states):
    inner = ["".join(pair) for pair in itertools.product("ab", repeat=5)]
    a = (allow(*(f"*{text}*{text[::-1]}*a" for text in inner)),)
    b = (allow(*(f"*{text}*{text[::-1]}*" for text in inner)),)
    found = difference(a, b, universe=UNIVERSE, budget=SearchBudget(states))
    assert isinstance(found, Unknown)
    assert str(states) in found.reason


def test_a_deadline_is_kept():
    found = difference(
        (allow(*(f"*{n}*" for n in range(400))),), (allow("*1*"),), budget=SearchBudget(go_on=lambda: False)
    )
    assert found == Unknown("not decided in time")


HARD = {
    "overlapping infixes": lambda texts: ([f"*{t}*" for t in texts], [p for t in texts for p in (f"*{t}", f"*{t}?*")]),
    "two infixes": lambda texts: (
        [f"*{t}*{t}x*" for t in texts],
        [p for t in texts for p in (f"*{t}{t}x*", f"*{t}?*{t}x*")],
    ),
    "far from the end": lambda texts: (
        [f"*{t}{'?' * 24}" for t in texts],
        [p for t in texts for p in (f"*{t}{'?' * 23}[!b]", f"*{t}{'?' * 23}b")],
    ),
    "pigeonholes": lambda texts: (
        [f"{t}{'?' * 16}" for t in texts],
        [f"{t}{'?' * n}[!a]{'?' * (15 - n)}" for t in texts for n in range(16)] + [t + "a" * 16 for t in texts],
    ),
}


@pytest.mark.parametrize("family", HARD)
def test_hard_families_are_decided_or_unknown_and_never_wrong(family):
    texts = ["".join(pair) for pair in itertools.product("abcdefghij", "klmnopqrst")][:30]
    a, b = HARD[family](texts)
    budget = SearchBudget(200_000)
    equal = difference((allow(*a),), (allow(*b),), universe=PRINTABLE, budget=budget)
    assert isinstance(equal, Equal | Unknown)
    broken = difference((allow(*a),), (allow(*b[1:]),), universe=PRINTABLE, budget=budget)
    assert isinstance(broken, Witness | Unknown)


@settings(max_examples=tries(60, 300), deadline=None)
@given(lists, lists)
def test_a_last_field_that_is_never_empty(a, b):
    universe = replace(UNIVERSE, last_nonempty=True)
    shortest = next((word for word in WORDS if word and permits(a, word) != permits(b, word)), None)
    found = difference(a, b, universe=universe)
    assert agrees(found, shortest)
    other = ProductSearch(
        (b,), a, universe, Derivatives(patterns_of(a, b), universe), SearchBudget().state_counter()
    ).shortest()
    assert (other is None) == isinstance(found, Equal)


def test_only_the_last_field_is_never_empty():
    pairs = Universe(PRINTABLE.alphabet, fields=2, last_nonempty=True)
    assert "\0x" in pairs
    assert "x\0" not in pairs
    assert difference((), (allow("*\0"),), universe=pairs) == Equal()
    assert difference((), (allow("\0*"),), universe=pairs) == Witness("\0a", left=False)


def test_of_the_shortest_words_one_of_letters_is_preferred():
    found = difference((), (allow("a/[!b-z]", "/[!b-z]/"),), universe=PRINTABLE)
    assert found == Witness("a/a", left=False)


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
