# SPDX-License-Identifier: Apache-2.0
"""Compare decision lists over all words of a universe: the answer is exact, or unknown.

What the fast path does not answer is searched by two engines in turn. The cube search is the first: it alone decides
all hard families of ``benchmarks/proof.py`` and lists of 5,000 patterns, at which the product search fails. The product
search is needed for conjunctions of many lists, such as the attachments of nested profiles: it compares six of them
(``*a*`` … ``*f*``) within 12,500 states, and the cube search does not.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cache

from comarmor.patterns import evaluate
from comarmor.patterns.counterexample_search import CounterexampleSearch
from comarmor.patterns.decision_lists import (
    EVERY_WORD,
    BudgetError,
    DecisionList,
    Equal,
    ProofResult,
    SearchBudget,
    Universe,
    Unknown,
    Witness,
)
from comarmor.patterns.derivatives import Derivatives
from comarmor.patterns.glob import Glob
from comarmor.patterns.product_search import ProductSearch
from comarmor.patterns.steps import StepLimitError, step_limit

FIRST_STATES = 5_000
STATES_PER_PATTERN = 20
"""States of the cube search, in total and for each pattern, before the product search is tried."""
GROWTH = 10
"""Factor for the states of both engines after neither has decided."""
PRODUCT_COST = 50
"""A state of the product search holds all lists, and costs as much as this number of states of the cube search."""


def difference(
    a: DecisionList, *b: DecisionList, universe: Universe = EVERY_WORD, budget: SearchBudget | None = None
) -> ProofResult:
    """Compare a list with another one, or with the conjunction of several.

    Args:
        a: a list.
        b: lists; together they permit the words that every one of them permits.
        universe: the words to compare.
        budget: cost limits.

    Returns:
        :class:`Equal`, a shortest :class:`Witness` on which they differ, or :class:`Unknown` if the budget was spent.
    """
    budget = budget or SearchBudget()
    return _within(budget, lambda: _difference(a, b, universe, budget))


def escapes(
    permitting: Sequence[DecisionList],
    denying: DecisionList,
    universe: Universe = EVERY_WORD,
    budget: SearchBudget | None = None,
) -> ProofResult:
    """Test whether a list permits every word that all of some lists permit.

    Returns:
        :class:`Equal` if so; else a shortest :class:`Witness` that they permit and it denies, or :class:`Unknown`.
    """
    budget = budget or SearchBudget()
    return _within(budget, lambda: _escape(permitting, denying, universe, budget))


def _within(budget: SearchBudget, answer: Callable[[], ProofResult]) -> ProofResult:
    """Answer a question within the step limit of its budget, or an outer one."""
    try:
        with step_limit(budget.steps):
            return answer()
    except (BudgetError, StepLimitError) as error:
        return Unknown(str(error))


def _difference(a: DecisionList, b: Sequence[DecisionList], universe: Universe, budget: SearchBudget) -> ProofResult:
    if evaluate.equal(a, b, universe):
        return Equal()
    word = _shortest_difference(a, b, universe, budget)
    if word is None:
        return Equal()
    left = evaluate.permits(a, word)
    if left is all(evaluate.permits(each, word) for each in b):
        raise AssertionError(f"the lists do not differ on {word!r}")
    return Witness(word, left)


def _shortest_difference(
    a: DecisionList, b: Sequence[DecisionList], universe: Universe, budget: SearchBudget
) -> str | None:
    """Return the shortest word on which a list differs from the conjunction of others, or None.

    Raises:
        BudgetError: neither engine decided within the budget.
    """
    derivatives = cache(lambda: Derivatives(_patterns((a, *b)), universe))
    states = FIRST_STATES + STATES_PER_PATTERN * sum(1 for _ in _patterns((a, *b)))
    while states < budget.states and budget.go_on():
        with suppress(BudgetError):
            return _search_cubes(a, b, universe, derivatives, replace(budget, states=states))
        with suppress(BudgetError):
            product_budget = replace(budget, states=max(1, states // PRODUCT_COST))
            return ProductSearch(b, a, universe, derivatives(), product_budget.state_counter()).shortest()
        states *= GROWTH
    try:
        return _search_cubes(a, b, universe, derivatives, budget)
    except BudgetError as error:
        with suppress(BudgetError):
            return ProductSearch(b, a, universe, derivatives(), budget.state_counter()).shortest()
        raise error from None


def _search_cubes(
    a: DecisionList,
    b: Sequence[DecisionList],
    universe: Universe,
    derivatives: Callable[[], Derivatives],
    budget: SearchBudget,
) -> str | None:
    count_state = budget.state_counter()

    def search(permitting: Sequence[DecisionList], denying: DecisionList, best: str | None) -> str | None:
        limit = None if best is None else len(best)
        return CounterexampleSearch(permitting, denying, universe, derivatives, count_state).shortest(limit)

    best: str | None = None
    for each in b:
        word = search((a,), each, best)
        best = best if word is None else word
    word = search(b[:1], a, best)
    if word is not None and not all(evaluate.permits(each, word) for each in b[1:]):
        word = search(b, a, best)
    return best if word is None else word


def _escape(
    permitting: Sequence[DecisionList], denying: DecisionList, universe: Universe, budget: SearchBudget
) -> ProofResult:
    if len(permitting) == 1 and evaluate.implies(permitting[0], denying, universe):
        return Equal()
    derivatives = cache(lambda: Derivatives(_patterns((*permitting, denying)), universe))
    search = CounterexampleSearch(permitting, denying, universe, derivatives, budget.state_counter())
    word = search.shortest()
    if word is None:
        return Equal()
    if not all(evaluate.permits(each, word) for each in permitting) or evaluate.permits(denying, word):
        raise AssertionError(f"the word {word!r} is no counterexample")
    return Witness(word, left=True)


def _patterns(lists: Sequence[DecisionList]) -> Iterator[Glob]:
    return (pattern for decisions in lists for block in decisions for pattern in block.patterns)
