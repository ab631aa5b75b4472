# SPDX-License-Identifier: Apache-2.0
"""Evaluate decision lists: decide about one word."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import cached_property

from comarmor.patterns.decision_lists import DecisionList
from comarmor.patterns.glob import Glob, literal
from comarmor.patterns.matching import Matcher, matcher, matches
from comarmor.patterns.pattern_index import PatternIndex

INDEX_FROM = 8
"""Number of patterns above which an index is faster than trying them one by one."""


def permits(decisions: DecisionList, word: str) -> bool:
    """Return whether a decision list permits a word, by definition: counterexamples are checked with it."""
    for block in decisions:
        if any(matches(pattern, word) for pattern in block.patterns):
            return block.allows
    return False


class Evaluator:
    """Decides as :func:`permits` does, fast for many words.

    Args:
        decisions: the list.
        literals: whether to consider patterns without wildcards.

    Attributes:
        literals: the words that are patterns themselves, with the first block that has them.
        wild: the other patterns, with the first block that has them.
        effects: whether each block allows.
    """

    def __init__(self, decisions: DecisionList, *, literals: bool = True) -> None:
        self.effects = [block.allows for block in decisions]
        self.literals: dict[str, int] = {}
        self.wild: dict[Glob, int] = {}
        for number, block in enumerate(decisions):
            for pattern in block.patterns:
                # Mostly names: without a call for each of them.
                text = pattern[0] if len(pattern) == 1 else literal(pattern)
                if not isinstance(text, str):
                    self.wild.setdefault(pattern, number)
                elif literals:
                    self.literals.setdefault(text, number)
        self._first_wild = min(self.wild.values(), default=len(decisions))

    def permits(self, word: str) -> bool:
        """Return whether the list permits a word."""
        first = self.literals.get(word, len(self.effects))
        if first > self._first_wild:
            first = self._first_match(word, first)
        return first < len(self.effects) and self.effects[first]

    def permitted_literals(self) -> Iterator[str]:
        """Yield the permitted words among :attr:`literals`."""
        for word, number in self.literals.items():
            if self.effects[number] if number <= self._first_wild else self.permits(word):
                yield word

    def _first_match(self, word: str, before: int) -> int:
        """Return the first block before another one with a wildcard pattern that matches a word, or that other one."""
        if len(self.wild) > INDEX_FROM:
            return min((number for _, number in self._index.matching(word) if number < before), default=before)
        for test, number in self._tests:
            if number >= before:
                break
            if test(word):
                return number
        return before

    @cached_property
    def _tests(self) -> list[tuple[Matcher, int]]:
        """The patterns with wildcards as functions, in the order of the blocks."""
        return [(matcher(pattern), number) for pattern, number in self.wild.items()]

    @cached_property
    def _index(self) -> PatternIndex[int]:
        return PatternIndex(self.wild.items())


def shortest(words: Iterable[str]) -> str | None:
    """Return the shortest word, the first in order among several; None if there are no words."""
    return min(words, key=lambda word: (len(word), word), default=None)
