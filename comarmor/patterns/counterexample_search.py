# SPDX-License-Identifier: Apache-2.0
"""Search for a shortest word on which decision lists differ, with two engines in turn.

The cube search is the first: it alone decides all hard families of ``benchmarks/proof.py`` and lists of 5,000 patterns,
at which the product search fails. Words that some lists permit and another one denies are a union of cubes "matches p,
and q, and none of these". This module makes the cubes; :mod:`comarmor.patterns.derivatives` searches each.

The product search is needed for conjunctions of many lists, such as the attachments of nested profiles: it compares six
of them (``*a*`` … ``*f*``) within 12,500 states, and the cube search does not. It determinises both sides together,
letter by letter, as far as needed: a state is the rest of every list, and if both sides are equal from there on,
nothing is left to search.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from functools import cache, cached_property, partial
from itertools import chain

from comarmor.patterns.decision_lists import BudgetError, DecisionList, SearchBudget, Universe
from comarmor.patterns.derivatives import CubeSearch, Derivatives
from comarmor.patterns.evaluate import Evaluator, permits, shortest
from comarmor.patterns.glob import Glob, literal, matcher
from comarmor.patterns.pattern_index import PatternIndex
from comarmor.patterns.relations import disjoint, ends_differ
from comarmor.patterns.steps import spend
from comarmor.values import Data, field, replace

FIRST_STATES = 5_000
STATES_PER_PATTERN = 20
"""States of the cube search, in total and for each pattern, before the product search is tried."""
GROWTH = 10
"""Factor for the states of both engines after neither has decided."""
PRODUCT_COST = 50
"""A state of the product search holds all lists, and costs as much as this number of states of the cube search."""
ROUNDS = 16
"""Searches of a cube with a part of its excluded patterns, before all of them are used."""


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


# -- the cube search --------------------------------------------------------------------------------------------------

_Ranked = tuple[Glob, int]
"""A pattern of a list, and the number of its block, which decides words that match unless an earlier opposite does."""


class CounterexampleSearch(Data, frozen=False, eq=False):
    """Searches for the shortest word that all of some lists permit and another list denies.

    Attributes:
        permitting: the lists that permit.
        denying: the list that denies.
        universe: the words of the question.
        derivatives: returns the derivatives for all patterns of the lists; called only when needed.
        count_state: called for every state.
    """

    permitting: Sequence[DecisionList]
    denying: DecisionList
    universe: Universe
    derivatives: Callable[[], Derivatives]
    count_state: Callable[[], None]
    _permits: list[_Opposites] = field(init=False)
    _denies: _Opposites = field(init=False)
    _relevant_denials: dict[int, PatternIndex[int]] = field(init=False, default_factory=dict)

    def __post_init__(self) -> None:
        self._permits = [_Opposites(each, allows=False) for each in self.permitting]
        self._denies = _Opposites(self.denying, allows=True)

    def shortest(self, limit: int | None = None) -> str | None:
        """Return the shortest word, or None.

        Args:
            limit: consider only words that are shorter.

        Raises:
            BudgetError: the budget is spent.
        """
        best = self._among_literals()
        bound = limit if best is None else len(best) if limit is None else min(limit, len(best))
        for positives, excluded in self._cubes(bound):
            word = self._search(positives, excluded, bound)
            if word is not None:
                best, bound = word, len(word)
        return best if best is not None and (limit is None or len(best) < limit) else None

    def _among_literals(self) -> str | None:
        """Return the shortest word among the literal patterns."""
        permitting = [Evaluator(each) for each in self.permitting]
        denying = Evaluator(self.denying)
        words: set[str] = set().union(*(each.literals for each in (*permitting, denying)))
        return shortest(
            word
            for word in words
            if all(each.permits(word) for each in permitting) and not denying.permits(word) and word in self.universe
        )

    def _cubes(self, bound: int | None) -> Iterator[tuple[list[Glob], list[_Excluded]]]:
        """Yield the cubes of words that are no literal pattern: positive and excluded patterns.

        Cubes without a word that is shorter than the bound may be left out.
        """
        for chosen in self._choices(0, ()):
            positives = [pattern for pattern, _ in chosen]
            excluded = [(own, block) for own, (_, block) in zip(self._permits, chosen, strict=True)]
            yield positives, [*excluded, (self._denies, len(self.denying))]
            for denial, block in self._relevant(chosen[0][1], bound).candidates(positives[0]):
                self.count_state()
                if not any(disjoint(denial, each) for each in positives):
                    yield [*positives, denial], [*excluded, (self._denies, block)]

    def _choices(self, number: int, chosen: tuple[_Ranked, ...]) -> Iterator[tuple[_Ranked, ...]]:
        """Yield one allowing pattern of each list, if a word may match all of them."""
        if number == len(self.permitting):
            yield chosen
            return
        deciding = self._permits[number].deciding
        for ranked in deciding.candidates(chosen[0][0]) if chosen else deciding:
            self.count_state()
            if not any(disjoint(ranked[0], other) for other, _ in chosen):
                yield from self._choices(number + 1, (*chosen, ranked))

    def _relevant(self, block: int, bound: int | None) -> PatternIndex[int]:
        """Return the denying patterns that match a word which the first list does not deny before a block; cached."""
        if block not in self._relevant_denials:
            excluded = [(self._permits[0], block)]
            self._relevant_denials[block] = PatternIndex(
                item for item in self._denies.deciding if self._search([item[0]], excluded, bound) is not None
            )
        return self._relevant_denials[block]

    def _search(self, positives: Sequence[Glob], excluded: Sequence[_Excluded], bound: int | None) -> str | None:
        """Return the shortest word in a cube that is shorter than a bound.

        Usually few of the excluded patterns matter. So the search begins without them, and adds those that match the
        word it returns. A word that no further excluded pattern matches is a shortest word of the cube.
        """
        if any(patterns.has(each, blocks) for patterns, blocks in excluded for each in positives):
            return None
        considered: dict[Glob, None] = {}
        for _ in range(ROUNDS):
            word = CubeSearch(self.derivatives(), positives, considered, self.count_state).shortest(bound)
            if word is None:
                return None
            matching = [pattern for patterns, blocks in excluded for pattern in patterns.matching(word, blocks)]
            if not matching:
                return word
            considered.update(dict.fromkeys(matching))
        meeting = (pattern for patterns, blocks in excluded for pattern in patterns.meeting(positives, blocks))
        return CubeSearch(self.derivatives(), positives, _without_covered(meeting), self.count_state).shortest(bound)


_Excluded = tuple["_Opposites", int]
"""The excluded patterns, and the number of blocks from the first whose patterns count."""


def _without_covered(patterns: Iterable[Glob]) -> tuple[Glob, ...]:
    """Return patterns without the literals that another pattern matches."""
    texts = {pattern: literal(pattern) for pattern in patterns}
    if set(texts.values()) == {None}:
        return tuple(texts)
    wild = [matcher(pattern) for pattern, text in texts.items() if text is None]
    return tuple(each for each, text in texts.items() if text is None or not any(matches(text) for matches in wild))


class _Opposites:
    """The patterns of the blocks of one effect, and those of the other effect, which they take words from.

    Args:
        decisions: the list.
        allows: effect of the blocks whose patterns are excluded.

    Attributes:
        deciding: the patterns with wildcards of the other blocks, each with its first block.
    """

    def __init__(self, decisions: DecisionList, *, allows: bool) -> None:
        self._excluded: dict[Glob, int] = {}
        deciding: dict[Glob, int] = {}
        for number, block in enumerate(decisions):
            for pattern in block.patterns:
                if block.allows is allows:
                    self._excluded.setdefault(pattern, number)
                elif literal(pattern) is None:
                    deciding.setdefault(pattern, number)
        self.deciding = PatternIndex(deciding.items())

    @cached_property
    def _index(self) -> PatternIndex[int]:
        return PatternIndex(self._excluded.items())

    def has(self, pattern: Glob, blocks: int) -> bool:
        """Return whether a pattern itself is excluded by the first blocks."""
        return self._excluded.get(pattern, blocks) < blocks

    def matching(self, word: str, blocks: int) -> Iterator[Glob]:
        """Yield the excluded patterns of the first blocks that match a word."""
        return (pattern for pattern, block in self._index.matching(word) if block < blocks)

    def meeting(self, positives: Sequence[Glob], blocks: int) -> Iterator[Glob]:
        """Yield the excluded patterns of the first blocks that may match a word which all positive patterns match."""
        tests = [matcher(each) for each in positives]
        for pattern, block in self._index.candidates(positives[0]):
            if block >= blocks:
                continue
            text = literal(pattern)
            if text is None:
                if not any(ends_differ(pattern, each) for each in positives[1:]):
                    yield pattern
            elif all(matches(text) for matches in tests):
                yield pattern


# -- the product search -----------------------------------------------------------------------------------------------

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
