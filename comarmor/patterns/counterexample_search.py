# SPDX-License-Identifier: Apache-2.0
"""Search for a shortest word that some decision lists permit and another one denies.

Such words are a union of cubes "matches p, and q, and none of these". This module makes the cubes;
:mod:`comarmor.patterns.derivatives` searches each.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cached_property

from comarmor.patterns.decision_lists import DecisionList, Universe
from comarmor.patterns.derivatives import CubeSearch, Derivatives
from comarmor.patterns.evaluate import Evaluator, shortest
from comarmor.patterns.glob import Glob, literal, matcher
from comarmor.patterns.pattern_index import PatternIndex
from comarmor.patterns.relations import disjoint, ends_differ
from comarmor.values import Data, field

ROUNDS = 16
"""Searches of a cube with a part of its excluded patterns, before all of them are used."""


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
