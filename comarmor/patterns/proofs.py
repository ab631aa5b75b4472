# SPDX-License-Identifier: Apache-2.0
"""Compare decision lists over all words of a universe: the answer is exact, or unknown.

What the fast path of :mod:`~comarmor.patterns.evaluate` does not answer is searched by
:mod:`~comarmor.patterns.counterexample_search`.
"""

from __future__ import annotations

from collections.abc import Sequence

from comarmor.patterns import evaluate
from comarmor.patterns.decision_lists import EVERY_WORD, DecisionList, ProofResult, SearchBudget, Universe
from comarmor.patterns.evaluate import permits


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
    limits = budget or SearchBudget()

    def search() -> str | None:
        if evaluate.equal(a, b, universe):
            return None
        from comarmor.patterns.counterexample_search import shortest_difference  # noqa: PLC0415 - most questions need no search

        return shortest_difference(a, b, universe, limits)

    return limits.answer(search, lambda word: (permits(a, word), all(permits(each, word) for each in b)))


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
    limits = budget or SearchBudget()

    def search() -> str | None:
        if len(permitting) == 1 and evaluate.implies(permitting[0], denying, universe):
            return None
        from comarmor.patterns.counterexample_search import shortest_escape  # noqa: PLC0415 - most questions need no search

        return shortest_escape(permitting, denying, universe, limits)

    def is_denied(word: str) -> bool:
        return all(permits(each, word) for each in permitting) and not permits(denying, word)

    return limits.answer(search, lambda word: (True, not is_denied(word)))
