# SPDX-License-Identifier: Apache-2.0
"""Search for a shortest word on which decision lists differ, with two engines in turn.

The cube search (:mod:`~comarmor.patterns.counterexample_search`) is the first: it alone decides all hard families of
``benchmarks/proof.py`` and lists of 5,000 patterns, at which the product search fails. The product search is needed for
conjunctions of many lists, such as the attachments of nested profiles: it compares six of them (``*a*`` … ``*f*``)
within 12,500 states, and the cube search does not. It determinises both sides together, letter by letter, as far as
needed: a state is the rest of every list, and if both sides are equal from there on, nothing is left to search.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from functools import cache, partial
from itertools import chain

from comarmor.patterns.counterexample_search import CounterexampleSearch
from comarmor.patterns.decision_lists import BudgetError, DecisionList, SearchBudget, Universe
from comarmor.patterns.derivatives import Derivatives
from comarmor.patterns.evaluate import Evaluator, permits, shortest
from comarmor.patterns.glob import Glob, literal
from comarmor.patterns.steps import spend
from comarmor.values import Data, replace

FIRST_STATES = 5_000
STATES_PER_PATTERN = 20
"""States of the cube search, in total and for each pattern, before the product search is tried."""
GROWTH = 10
"""Factor for the states of both engines after neither has decided."""
PRODUCT_COST = 50
"""A state of the product search holds all lists, and costs as much as this number of states of the cube search."""


def shortest_escape(
    permitting: Sequence[DecisionList], denying: DecisionList, universe: Universe, budget: SearchBudget
) -> str | None:
    """Return the shortest word that all of some lists permit and another one denies, or None.

    Raises:
        BudgetError: the budget is spent.
    """
    derivatives = _derivatives((*permitting, denying), universe)
    return CounterexampleSearch(permitting, denying, universe, derivatives, budget.state_counter()).shortest()


def shortest_difference(
    a: DecisionList, b: Sequence[DecisionList], universe: Universe, budget: SearchBudget
) -> str | None:
    """Return the shortest word on which a list differs from the conjunction of others, or None.

    Raises:
        BudgetError: neither engine decided within the budget.
    """
    derivatives = _derivatives((a, *b), universe)

    def search_cubes(budget: SearchBudget) -> str | None:
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

    states = FIRST_STATES + STATES_PER_PATTERN * sum(1 for _ in _patterns((a, *b)))
    while states < budget.states and budget.go_on():
        with suppress(BudgetError):
            return search_cubes(replace(budget, states=states))
        with suppress(BudgetError):
            product_budget = replace(budget, states=max(1, states // PRODUCT_COST))
            return ProductSearch(b, a, universe, derivatives(), product_budget.state_counter()).shortest()
        states *= GROWTH
    try:
        return search_cubes(budget)
    except BudgetError as error:
        with suppress(BudgetError):
            return ProductSearch(b, a, universe, derivatives(), budget.state_counter()).shortest()
        raise error from None


def _derivatives(lists: Sequence[DecisionList], universe: Universe) -> Callable[[], Derivatives]:
    """Return a function that returns the derivatives for all patterns of some lists; some searches need none."""
    return cache(lambda: Derivatives(_patterns(lists), universe))


def _patterns(lists: Sequence[DecisionList]) -> Iterator[Glob]:
    return (pattern for decisions in lists for block in decisions for pattern in block.patterns)


Residual = tuple[tuple[bool, frozenset[int]], ...]
"""The rest of a list: blocks with alternating effects, of which the last one allows."""
_State = tuple[int, tuple[Residual, ...], Residual, frozenset[int]]


class ProductSearch(Data, eq=False):
    """Searches for the shortest word on which a conjunction of lists and another list differ.

    Attributes:
        together: lists; together they permit the words that all of them permit.
        other: the list to compare with them.
        universe: the words to compare.
        derivatives: derivatives of all patterns of the lists.
        count_state: called for every state.
    """

    together: Sequence[DecisionList]
    other: DecisionList
    universe: Universe
    derivatives: Derivatives
    count_state: Callable[[], None]

    def shortest(self) -> str | None:
        """Return the shortest word, or None when both sides are equal.

        Raises:
            BudgetError: the budget is spent.
        """
        best, apart = self._among_literals()
        start: _State = (
            self.derivatives.universe,
            tuple(self._residual(decisions) for decisions in self.together),
            self._residual(self.other),
            frozenset(self.derivatives.node((text,) if text else ()) for text in apart),
        )
        residual_after = cache(partial(_residual_after, self.derivatives))
        level: list[tuple[_State, str]] = [(start, "")]
        seen = {start}
        length = 0
        while level and (best is None or length < len(best)):
            for state, word in level:
                if self._differs(state):
                    return word
            following: list[tuple[_State, str]] = []
            for state, word in level:
                nodes = _nodes(state)
                for letter in self.derivatives.letters_to_try(nodes):
                    spend(1 + len(nodes) // 4)
                    after = self._step(state, letter, residual_after)
                    if after is not None and after not in seen:
                        self.count_state()
                        seen.add(after)
                        following.append((after, word + letter))
            level = following
            length += 1
        return best

    def _among_literals(self) -> tuple[str | None, list[str]]:
        """Decide the words that are literal patterns.

        Returns:
            the shortest one on which the sides differ; and those on which they would differ without literal patterns,
            at which the search must not stop.
        """
        lists = (*self.together, self.other)
        full, wild = ([Evaluator(decisions, literals=flag) for decisions in lists] for flag in (True, False))
        texts = {text for evaluator in full for text in evaluator.literals if text in self.universe}

        def differs(evaluators: list[Evaluator], text: str) -> bool:
            return all(evaluator.permits(text) for evaluator in evaluators[:-1]) is not evaluators[-1].permits(text)

        return shortest(t for t in texts if differs(full, t)), sorted(t for t in texts if differs(wild, t))

    def _residual(self, decisions: DecisionList) -> Residual:
        node = self.derivatives.node
        blocks = (
            (block.allows, frozenset(node(pattern) for pattern in block.patterns if literal(pattern) is None))
            for block in decisions
        )
        return _reduced(blocks, self.derivatives.everything)

    def _step(self, state: _State, letter: str, after: Callable[[Residual, str], Residual]) -> _State | None:
        """Return the state after a letter; None if no word of the universe, or no difference, follows."""
        place, together, other, apart = state
        inside = self.derivatives.step(place, letter)
        if not inside:
            return None
        left = tuple(after(residual, letter) for residual in together)
        right = after(other, letter)
        if all(residual == right for residual in left):
            return None
        return inside[0], left, right, self.derivatives.steps(apart, letter)

    def _differs(self, state: _State) -> bool:
        place, together, other, apart = state
        accepts = self.derivatives.accepts
        if not accepts[place] or any(accepts[node] for node in apart):
            return False
        return all(self._permits(residual) for residual in together) is not self._permits(other)

    def _permits(self, residual: Residual) -> bool:
        accepts = self.derivatives.accepts
        return next((allows for allows, nodes in residual if any(accepts[node] for node in nodes)), False)


def _residual_after(derivatives: Derivatives, residual: Residual, letter: str) -> Residual:
    """Return the rest of a list after a letter."""
    return _reduced(((allows, derivatives.steps(nodes, letter)) for allows, nodes in residual), derivatives.everything)


def _nodes(state: _State) -> list[int]:
    place, together, other, apart = state
    blocks = chain.from_iterable((*together, other))
    return [place, *chain.from_iterable(nodes for _, nodes in blocks), *apart]


def _reduced(blocks: Iterable[tuple[bool, frozenset[int]]], everything: int) -> Residual:
    """Drop nodes of earlier blocks, blocks after one that matches every word, and a last denial."""
    reduced: list[tuple[bool, frozenset[int]]] = []
    known: frozenset[int] = frozenset()
    for allows, nodes in blocks:
        new = frozenset((everything,)) if everything in nodes else nodes - known
        if not new:
            continue
        known |= new
        if reduced and reduced[-1][0] is allows:
            reduced[-1] = (allows, reduced[-1][1] | new)
        else:
            reduced.append((allows, new))
        if everything in new:
            reduced[-1] = (allows, new)
            break
    while reduced and not reduced[-1][0]:
        reduced.pop()
    return tuple(reduced)
