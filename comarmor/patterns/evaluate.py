# SPDX-License-Identifier: Apache-2.0
"""Decide about one word, and compare decision lists without a search.

The comparison is fast, sound and incomplete: False means unknown, and the caller searches. It answers the ordinary
question, in which both sides have the same patterns. Literal words are decided one by one. Of all other words a list
permits the union, over its allowing patterns with wildcards, of the words that the pattern matches and no denial before
it does. So a list implies another one if each of its allowing patterns occurs there as well (or a wider one does), and
every denial before it there either comes before it here, or has no word in common.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence, Set as AbstractSet
from functools import cached_property, lru_cache

from comarmor.patterns.decision_lists import Block, DecisionList, Universe
from comarmor.patterns.glob import EVERYTHING, Glob, Matcher, is_empty, literal, matcher, matches, prefix, suffix, words
from comarmor.patterns.pattern_index import PatternIndex
from comarmor.patterns.relations import disjoint
from comarmor.patterns.tokens import STAR, Charset

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

    def permitted_among(self, words: AbstractSet[str]) -> frozenset[str]:
        """Return the permitted ones of some words, which include all :attr:`literals`."""
        if self.allowed and len(words) > len(self.literals):
            return self._permitted.union(filter(self.permits, words - self.literals.keys()))
        return self._permitted

    @cached_property
    def allowed(self) -> dict[Glob, int]:
        """Patterns with wildcards that no earlier block denies, with the first block that allows each."""
        return {pattern: block for pattern, block in self.wild.items() if self.effects[block]}

    @cached_property
    def denied(self) -> dict[Glob, int]:
        """Patterns with wildcards that no earlier block allows, with the first block that denies each; in order."""
        return {pattern: block for pattern, block in self.wild.items() if not self.effects[block]}

    @cached_property
    def _permitted(self) -> frozenset[str]:
        """The permitted words among :attr:`literals`."""
        return frozenset(
            word
            for word, number in self.literals.items()
            if (self.effects[number] if number <= self._first_wild else self.permits(word))
        )

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


MAX_WORDS = 20_000
"""Most words that the sets in a list's patterns are expanded to."""
MAX_PAIRS = 2_000
"""Pairs of patterns to compare before the question is left to the search."""


def equal(a: DecisionList, b: Sequence[DecisionList], universe: Universe) -> bool:
    """Return whether a list provably permits the same words as the conjunction of others; False means unknown.

    Args:
        a: a list.
        b: lists, at least one; together they permit the words that every one of them permits.
        universe: the words to compare.
    """
    left, right = _split(a), tuple(map(_split, b))
    if not (any(_implies(each, left) for each in right) and all(_implies(left, each) for each in right)):
        return False
    words = left.literals.keys() | set().union(*(each.literals for each in right))
    permitted = frozenset.intersection(*(each.permitted_among(words) for each in right))
    return not any(word in universe for word in left.permitted_among(words) ^ permitted)


def implies(a: DecisionList, b: DecisionList, universe: Universe) -> bool:
    """Return whether another list provably permits every word that a list permits; False means unknown."""
    left, right = _split(a), _split(b)
    if not _implies(left, right):
        return False
    words = left.literals.keys() | right.literals.keys()
    return not any(word in universe for word in left.permitted_among(words) - right.permitted_among(words))


def _expanded(decisions: DecisionList) -> DecisionList:
    """Replace patterns that match few words by these words, which can be decided one by one."""
    remaining = MAX_WORDS
    blocks: list[Block] = []
    for block in decisions:
        patterns: list[Glob] = []
        for pattern in block.patterns:
            expansion = words(pattern, remaining) if literal(pattern) is None else ()
            remaining -= len(expansion)
            patterns += ((word,) for word in expansion) if expansion else (pattern,)
        blocks.append(Block(block.allows, tuple(patterns)))
    return tuple(blocks)


# An enclave asks about few lists, each several times: for each model, and in both directions.
@lru_cache(maxsize=16)
def _split(decisions: DecisionList) -> Evaluator:
    """Return the evaluator of a list, in which words stand for the patterns that match few."""
    evaluator = Evaluator(decisions)
    if any(isinstance(token, Charset) for pattern in evaluator.wild for token in pattern):
        return Evaluator(_expanded(decisions))
    return evaluator


def _implies(inner: Evaluator, outer: Evaluator) -> bool:
    """Return whether a list provably implies another one, except for words that are literals of either."""
    extra: dict[tuple[int, int], list[Glob]] = {}
    remaining = MAX_PAIRS
    for pattern, block in inner.allowed.items():
        for wider in _wider(pattern):
            outer_block = outer.allowed.get(wider)
            if outer_block is None:
                continue
            key = (block, outer_block)
            if key not in extra:
                extra[key] = list(_extra_denials(inner, block, outer, outer_block))
            remaining -= len(extra[key])
            if remaining < 0:
                return False
            if all(disjoint(denial, pattern) for denial in extra[key]):
                break
        else:
            is_denied = any(inner.denied.get(wider, block) < block for wider in _wider(pattern))
            if not (is_denied or is_empty(pattern)):
                return False
    return True


def _extra_denials(inner: Evaluator, block: int, outer: Evaluator, outer_block: int) -> Iterator[Glob]:
    """Yield the denials before a block of the outer list that are not before a block of the inner one."""
    for denial, number in outer.denied.items():
        if number >= outer_block:
            return
        if inner.denied.get(denial, block) >= block:
            yield denial


def _wider(pattern: Glob) -> Iterator[Glob]:
    """Yield a pattern, and patterns with one ``*`` at an end that match all that it matches."""
    yield pattern
    yield EVERYTHING
    head, tail = prefix(pattern), suffix(pattern)
    yield from ((head[:end], STAR) for end in range(1, len(head) + 1))
    yield from ((STAR, tail[start:]) for start in range(len(tail)))
