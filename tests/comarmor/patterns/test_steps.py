# SPDX-License-Identifier: Apache-2.0
"""The count of steps limits searches and does not depend on earlier calls."""

from __future__ import annotations

import pytest

from comarmor.patterns.decision_lists import Block, Equal, SearchBudget, Unknown
from comarmor.patterns.glob import parse
from comarmor.patterns.proofs import difference, escapes
from comarmor.patterns.relations import covers, disjoint, intersection
from comarmor.patterns.steps import StepLimitError, spend, step_counting_cache, step_limit
from tests.effort import calls_of


def test_steps_are_counted_and_end() -> None:
    with step_limit(10) as counter:
        spend(4)
        with step_limit(5):
            spend(3)
        assert counter.spent == 7
        with pytest.raises(StepLimitError, match="within 10 steps"), step_limit(50):
            spend(4)
        with pytest.raises(StepLimitError):
            spend()
    spend(1_000)


def test_a_cached_result_costs_the_same() -> None:
    @step_counting_cache
    def asked(number: int) -> int:
        spend(number)
        return number

    costs = []
    for _ in range(2):
        with step_limit(None) as counter:
            assert asked(5) == 5
        costs.append(counter.spent)
    assert costs == [6, 6]
    with step_limit(3), pytest.raises(StepLimitError):
        asked(5)
    with step_limit(3), pytest.raises(StepLimitError):
        asked(4)
    assert asked(4) == 4


@pytest.mark.parametrize(
    "ask",
    [
        lambda: disjoint(parse("*one[ab]*a*b"), parse("[!x]*?one*b*")),
        lambda: covers(parse("*one*a*b*"), parse("[!x]*?onea*b*")),
        lambda: len(intersection(parse("*one*a*b*"), parse("*two*c*"))),
    ],
)
def test_the_count_does_not_depend_on_the_past(ask) -> None:
    costs = []
    for _ in range(2):
        with step_limit(None) as counter:
            ask()
        costs.append(counter.spent)
    assert costs[0] == costs[1] > 10


def test_a_step_stands_for_a_bounded_amount_of_work() -> None:
    one, other = parse("*ab*cd*ef*"), parse("*mn*op*qr*")

    def ask() -> int:
        with step_limit(None) as counter:
            assert len(intersection(one, other, 100)) > 0
        return counter.spent

    steps, calls = calls_of(ask)
    assert calls < 60 * steps
    assert steps < 250_000


def test_a_question_that_takes_too_long_is_unknown() -> None:
    hard = tuple(parse(f"*a{'?' * each}b*{each}*") for each in range(12))
    a = (Block(True, hard), Block(False, (parse("*q"),)))
    b = (Block(True, hard[:-1]),)
    for question in (difference, lambda one, other, **more: escapes([one], other, **more)):
        with step_limit(200) as counter:
            assert isinstance(question(a, b), Unknown)
        assert counter.spent < 20_000
        assert isinstance(question(a, b, budget=SearchBudget(states=50)), Unknown)
        assert question(b, b) == Equal()
