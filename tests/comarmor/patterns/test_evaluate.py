# SPDX-License-Identifier: Apache-2.0
"""The fast evaluator decides as the definition does; what it proves without a search agrees with both engines."""

from __future__ import annotations

import random

import pytest
from hypothesis import given, settings, strategies as st

from comarmor.patterns import evaluate
from comarmor.patterns.counterexample_search import CounterexampleSearch, ProductSearch
from comarmor.patterns.decision_lists import Block, Equal, SearchBudget, Universe, Unknown
from comarmor.patterns.derivatives import Derivatives
from comarmor.patterns.evaluate import Evaluator, permits
from comarmor.patterns.proofs import difference, escapes
from comarmor.patterns.tokens import charset
from tests.effort import tries

from .small import PRINTABLE, UNIVERSE, WORDS, allow, deny, first_difference, globs, lists, patterns_of


@pytest.mark.parametrize("few", [0, evaluate.INDEX_FROM])
@settings(max_examples=tries(60, 200), deadline=None)
@given(lists)
def test_an_evaluator_decides_as_the_definition_does(few, decisions):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(evaluate, "INDEX_FROM", few)
        evaluator = Evaluator(decisions)
        permitted = {word for word in WORDS if evaluator.permits(word)}
        assert permitted == {word for word in WORDS if permits(decisions, word)}
        assert evaluator.permitted_among(evaluator.literals.keys()) == {
            word for word in evaluator.literals if permits(decisions, word)
        }


NARROW = Universe(charset([(97, 97)]))
"""A universe that most of the patterns go beyond."""


def without_search(a, *b, universe=PRINTABLE):
    """Compare lists with a budget that allows no search."""
    return difference(a, *b, universe=universe, budget=SearchBudget(0))


@st.composite
def alike(draw):
    """A list, and one that is often equal: made of its patterns, in another order and other blocks."""
    a = draw(lists)
    b = [Block(block.allows, (pattern,)) for block in a for pattern in block.patterns]
    for _ in range(draw(st.integers(0, 3))):
        at = draw(st.integers(0, len(b)))
        match draw(st.sampled_from(["add", "drop", "swap", "repeat"])):
            case "add":
                b.insert(at, Block(draw(st.booleans()), (draw(globs),)))
            case "drop":
                del b[at : at + 1]
            case "swap":
                b[at : at + 2] = reversed(b[at : at + 2])
            case "repeat":
                b[at:at] = b[at : at + 1]
    return a, tuple(b)


@settings(max_examples=tries(250, 1500), deadline=None)
@given(alike())
def test_lists_that_are_proven_equal_are_equal(pair):
    a, b = pair
    if evaluate.equal(a, (b,), UNIVERSE):
        assert first_difference(a, b) is None
    if evaluate.implies(a, b, UNIVERSE):
        assert not any(permits(a, word) and not permits(b, word) for word in WORDS)


@settings(max_examples=tries(100, 600), deadline=None)
@given(alike(), st.one_of(lists, alike().map(lambda pair: pair[1])))
def test_of_several_lists_too(pair, other):
    a, b = pair
    wider = (*b, *other)
    for together in ((b, wider), (wider, b), (b, other)):
        if evaluate.equal(a, together, UNIVERSE):
            assert first_difference(a, *together) is None


@settings(max_examples=tries(80, 400), deadline=None)
@given(alike(), st.sampled_from([UNIVERSE, NARROW, PRINTABLE]))
def test_no_engine_contradicts(pair, universe):
    a, b = pair
    derivatives = Derivatives(patterns_of(a, b), universe)

    def escape(left, right):
        return CounterexampleSearch(
            (left,), right, universe, lambda: derivatives, SearchBudget().state_counter()
        ).shortest()

    if evaluate.implies(a, b, universe):
        assert escape(a, b) is None
    if evaluate.equal(a, (b,), universe):
        assert escape(a, b) is None
        assert escape(b, a) is None
        assert ProductSearch((b,), a, universe, derivatives, SearchBudget().state_counter()).shortest() is None


@settings(max_examples=tries(60, 200), deadline=None)
@given(lists)
def test_a_list_is_proven_to_equal_itself(a):
    assert evaluate.equal(a, (a,), UNIVERSE)
    assert evaluate.equal(a, (a, a), UNIVERSE)


@pytest.mark.parametrize(
    ("a", "b"),
    [
        pytest.param((deny("x/p"), allow("x/*", "y")), (allow("y"), deny("x/p"), allow("x/*")), id="order"),
        pytest.param((deny("a*", "b*"), allow("c*", "a*z")), (allow("c*"),), id="denials of nothing"),
        pytest.param((deny("*p"), allow("*q", "x*")), (allow("*q"), deny("*p"), allow("x*")), id="apart"),
        pytest.param((allow("x*", "xy*", "xyz"),), (allow("x*"),), id="covered"),
        pytest.param((allow("x*"), deny("x*", "q")), (allow("x*"),), id="denied too late"),
        pytest.param((deny("x*"), allow("x*", "y")), (allow("y"),), id="allowed too late"),
        pytest.param((allow("*"), deny("b"), allow("c")), (allow("*"),), id="after everything"),
    ],
)
def test_what_a_compiler_rewrites_needs_no_search(a, b):
    assert without_search(a, b) == Equal()
    assert without_search(b, a) == Equal()


def test_a_topic_check_that_holds_both_directions_needs_no_search():
    a = (deny("rt/x/p"), allow("rt/x*", "rq/a"))
    endpoint = (allow("rq/a"), deny("rt/x/p"), allow("rt/x*"))
    topics = (allow("rq/a", "rr/b", "rt/clock"), deny("rt/x/p"), allow("rt/x*", "rt/y*"))
    assert without_search(a, endpoint, topics) == Equal()
    assert without_search(a, topics, endpoint) == Equal()


def test_words_outside_of_the_universe_do_not_count():
    assert without_search((allow("a", "b"),), (allow("a"),), universe=NARROW) == Equal()
    assert not evaluate.equal((allow("a", "b"),), ((allow("a"),),), UNIVERSE)


@pytest.mark.parametrize(
    ("a", "b"),
    [
        ((allow("x*"),), (allow("x", "x?*"),)),
        ((allow("x*"),), (allow("x?*"),)),
        ((deny("*p*"), allow("x*")), (allow("x*"),)),
        ((allow("x*"),), (deny("xp*"), allow("x*"))),
        ((allow("x*"),), (allow("x*"), allow("y*"))),
    ],
)
def test_other_questions_are_left_to_the_search(a, b):
    assert isinstance(without_search(a, b), Unknown)


def test_implication_needs_no_search_where_a_wider_pattern_stands():
    narrow = (deny("x/p*"), allow("x/*", "y"))
    assert escapes([narrow], (allow("y*"), deny("x/p*"), allow("x*")), PRINTABLE, SearchBudget(0)) == Equal()
    assert isinstance(escapes([narrow], (allow("x/*"),), PRINTABLE, SearchBudget(0)), Unknown)


def test_the_number_of_pairs_is_limited(monkeypatch):
    dice = random.Random(1)
    inner = [f"*{dice.randrange(10**6)}*" for _ in range(20)]
    a, b = (deny(*inner), allow("x*")), (deny(*inner, "y*"), allow("x*"))
    assert evaluate.equal(a, (b,), PRINTABLE)
    monkeypatch.setattr(evaluate, "MAX_PAIRS", 0)
    assert not evaluate.equal(a, (b,), PRINTABLE)
