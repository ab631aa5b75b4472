"""Compare decision lists over all words of a universe: the answer is exact, or unknown.

One engine answers what the fast path does not: a search of cubes with antichains. A second one, which determinised both
lists together, decided no hard family of ``benchmarks/proof.py`` that the first one does not decide within the same
budget, and failed on lists of 5,000 patterns; it remains an oracle of the tests.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import cache

from comarmor.patterns import fast_path
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
from comarmor.patterns.evaluate import permits
from comarmor.patterns.glob import Glob
from comarmor.patterns.steps import StepLimitError, step_limit


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


def implies(
    a: DecisionList, b: DecisionList, universe: Universe = EVERY_WORD, budget: SearchBudget | None = None
) -> ProofResult:
    """Test whether a list permits only words that another one permits.

    Returns:
        :class:`Equal` if so; else a shortest :class:`Witness` that only ``a`` permits, or :class:`Unknown`.
    """
    budget = budget or SearchBudget()
    return _within(budget, lambda: Equal() if fast_path.implied(a, b, universe) else _escape((a,), b, universe, budget))


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
    if fast_path.equal(a, b, universe):
        return Equal()
    word = _shortest_difference(a, b, universe, budget)
    if word is None:
        return Equal()
    left = permits(a, word)
    if left is all(permits(each, word) for each in b):
        raise AssertionError(f"the lists do not differ on {word!r}")
    return Witness(word, left)


def _shortest_difference(
    a: DecisionList, b: Sequence[DecisionList], universe: Universe, budget: SearchBudget
) -> str | None:
    derivatives = cache(lambda: Derivatives(_patterns((a, *b)), universe))
    count_state = budget.state_counter()

    def search(permitting: Sequence[DecisionList], denying: DecisionList, best: str | None) -> str | None:
        limit = None if best is None else len(best)
        return CounterexampleSearch(permitting, denying, universe, derivatives, count_state).shortest(limit)

    best: str | None = None
    for each in b:
        word = search((a,), each, best)
        best = best if word is None else word
    word = search(b[:1], a, best)
    if word is not None and not all(permits(each, word) for each in b[1:]):
        word = search(b, a, best)
    return best if word is None else word


def _escape(
    permitting: Sequence[DecisionList], denying: DecisionList, universe: Universe, budget: SearchBudget
) -> ProofResult:
    derivatives = cache(lambda: Derivatives(_patterns((*permitting, denying)), universe))
    search = CounterexampleSearch(permitting, denying, universe, derivatives, budget.state_counter())
    word = search.shortest()
    if word is None:
        return Equal()
    if not all(permits(each, word) for each in permitting) or permits(denying, word):
        raise AssertionError(f"the word {word!r} is no counterexample")
    return Witness(word, left=True)


def _patterns(lists: Sequence[DecisionList]) -> Iterator[Glob]:
    return (pattern for decisions in lists for block in decisions for pattern in block.patterns)
