"""Implication that shows without a search: the ordinary question, in which both sides have their patterns in common.

Words that a list names exactly are decided one by one. Of all other words a list permits the union, over the wildcard
patterns that it allows, of what a pattern matches and no denial before it does. So a list is seen to imply another one
if each of its allowed patterns stands there too (or within a wider one), and every denial before it there either stands
before it here, or has no word in common with it. What is not seen is not denied: then the engines search.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from collections.abc import Set as AbstractSet
from functools import lru_cache
from itertools import product

from comarmor.patterns.decision_lists import Block, DecisionList, Universe
from comarmor.patterns.evaluate import Evaluator
from comarmor.patterns.glob import EVERYTHING, Glob, is_empty
from comarmor.patterns.relations import disjoint
from comarmor.patterns.tokens import STAR, Charset

WORDS = 20_000
"""Words that the patterns of a list are spelled out to, at most."""
EFFORT = 2_000
"""Pairs of patterns that are held against each other, before the question is left to the engines."""


def equal(a: DecisionList, b: Sequence[DecisionList], universe: Universe) -> bool:
    """Tell whether a list is seen to permit exactly the words that several others together permit.

    Args:
        a: a list.
        b: lists, at least one; together they permit what every one of them permits.
        universe: the words in question.

    Returns:
        True only if that is so; False where it is not seen.
    """
    left, right = _form(a), tuple(map(_form, b))
    if not (any(_within(each, left) for each in right) and all(_within(left, each) for each in right)):
        return False
    words = left.named | set().union(*(each.named for each in right))
    together = frozenset.intersection(*(each.among(words) for each in right))
    return not any(word in universe for word in left.among(words) ^ together)


def implied(a: DecisionList, b: DecisionList, universe: Universe) -> bool:
    """Tell whether every word that a list permits is seen to be permitted by another one, too.

    Returns:
        True only if that is so; False where it is not seen.
    """
    left, right = _form(a), _form(b)
    if not _within(left, right):
        return False
    words = left.named | right.named
    return not any(word in universe for word in left.among(words) - right.among(words))


class _Form:
    """A list, taken apart.

    Args:
        decisions: the list.

    Attributes:
        named: the words that are named exactly.
        allowed: wildcard patterns that no block before denies, and the first block that allows each.
        denied: wildcard patterns that no block before allows, and the first block that denies each, in this order.
    """

    __slots__ = ("_permits", "_permitted", "allowed", "denied", "named")

    def __init__(self, decisions: DecisionList) -> None:
        evaluator = Evaluator(_spelled_out(decisions))
        effects = evaluator.effects
        self.named: AbstractSet[str] = evaluator.named.keys()
        self.allowed = {pattern: at for pattern, at in evaluator.wild.items() if effects[at]}
        self.denied = {pattern: at for pattern, at in evaluator.wild.items() if not effects[at]}
        self._permits = evaluator.permits
        self._permitted = frozenset(evaluator.permitted())

    def among(self, words: AbstractSet[str]) -> frozenset[str]:
        """Return those of some words that the list permits; they include all that it names."""
        if self.allowed and len(words) > len(self.named):
            return self._permitted.union(filter(self._permits, words - self.named))
        return self._permitted

    def refuses(self, pattern: Glob, block: int) -> bool:
        """Tell whether a pattern is seen to be denied as a whole before a block."""
        return any(self.denied.get(wider, block) < block for wider in _wider(pattern))


def _spelled_out(decisions: DecisionList) -> DecisionList:
    """Return a list in which patterns that match a few words only are those words: they can be decided one by one."""
    if not any(isinstance(token, Charset) for block in decisions for pattern in block.patterns for token in pattern):
        return decisions
    left = WORDS
    blocks: list[Block] = []
    for block in decisions:
        patterns: list[Glob] = []
        for pattern in block.patterns:
            count = _count(pattern)
            if 1 < count <= left:
                left -= count
                choices = ([token] if isinstance(token, str) else token.chars() for token in pattern)  # type: ignore[union-attr]
                patterns += (("".join(parts),) for parts in product(*choices))
            else:
                patterns.append(pattern)
        blocks.append(Block(block.allows, tuple(patterns)))
    return tuple(blocks)


def _count(pattern: Glob) -> int:
    """Return how many words a pattern matches; 1 also for those that match endlessly many, which stay as they are."""
    if STAR in pattern:
        return 1
    count = 1
    for token in pattern:
        count *= 1 if isinstance(token, str) else len(token)  # type: ignore[arg-type]
    return count


# An enclave asks about few lists, each several times: for each model, and in both directions.
@lru_cache(maxsize=16)
def _form(decisions: DecisionList) -> _Form:
    return _Form(decisions)


def _within(inner: _Form, outer: _Form) -> bool:
    """Tell whether a list is seen to imply another one, of words that neither names exactly."""
    missing: dict[tuple[int, int], list[Glob]] = {}
    effort = EFFORT
    for pattern, at in inner.allowed.items():
        for wider in _wider(pattern):
            block = outer.allowed.get(wider)
            if block is None:
                continue
            if (at, block) not in missing:
                missing[at, block] = list(_missing(inner, at, outer, block))
            denials = missing[at, block]
            effort -= len(denials)
            if effort < 0:
                return False
            if all(disjoint(denial, pattern) for denial in denials):
                break
        else:
            if not (inner.refuses(pattern, at) or is_empty(pattern)):
                return False
    return True


def _missing(inner: _Form, at: int, outer: _Form, block: int) -> Iterator[Glob]:
    """Yield the denials before a block of one list that do not stand before a block of the other one."""
    for denial, place in outer.denied.items():
        if place >= block:
            return
        if inner.denied.get(denial, at) >= at:
            yield denial


def _wider(pattern: Glob) -> Iterator[Glob]:
    """Yield patterns that match all that a wildcard pattern matches, by its ends: first itself."""
    yield pattern
    yield EVERYTHING
    if pattern and isinstance(pattern[0], str):
        yield from ((pattern[0][:end], STAR) for end in range(1, len(pattern[0]) + 1))
    if pattern and isinstance(pattern[-1], str):
        yield from ((STAR, pattern[-1][start:]) for start in range(len(pattern[-1])))
