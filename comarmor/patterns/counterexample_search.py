"""The first engine: names that should not be, in cubes.

What some lists permit and another one refuses is a union of cubes "matches p, and q, and none of these". They are
made here; :mod:`comarmor.patterns.cube_search` searches each.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

from comarmor.patterns.cube_search import CountState, CubeSearch
from comarmor.patterns.decision_lists import DecisionList, Universe
from comarmor.patterns.derivatives import Derivatives
from comarmor.patterns.evaluate import Evaluator, Index, shortest
from comarmor.patterns.glob import Glob, literal
from comarmor.patterns.matching import matcher
from comarmor.patterns.relations import disjoint

ROUNDS = 16
"""Searches of a cube with some of the patterns that must not match, before all of them are taken."""


@dataclass(frozen=True, slots=True)
class RankedPattern:
    """One way in which a list permits or refuses: a word matches the pattern, and none of some blocks.

    Attributes:
        pattern: the pattern.
        unless: number of the blocks of the list, from the first, whose opposite patterns must not match.
    """

    pattern: Glob
    unless: int


class CounterexampleSearch:
    """Looks for the shortest word that all of some lists permit and another one refuses.

    Args:
        permitting: the lists that permit.
        refusing: the list that refuses.
        universe: the words in question.
        arena: returns the arena, with an alphabet for all patterns of the lists; called only when it is needed.
        meter: called for every state.
    """

    def __init__(
        self,
        permitting: Sequence[DecisionList],
        refusing: DecisionList,
        universe: Universe,
        arena: Callable[[], Derivatives],
        meter: CountState,
    ) -> None:
        self._permitting = permitting
        self._refusing = refusing
        self._universe = universe
        self._arena = arena
        self._meter = meter
        self._allowing = [_Patterns(each, allows=False) for each in permitting]
        self._denying = _Patterns(refusing, allows=True)
        self._remaining: dict[int, Heads] = {}

    def shortest(self, limit: int | None = None) -> str | None:
        """Return the shortest word, or None.

        Args:
            limit: only words that are shorter are of interest.

        Raises:
            SpentError: the budget is spent.
        """
        best = self._among_literals()
        bound = limit if best is None else len(best) if limit is None else min(limit, len(best))
        for positives, limits in self._cubes(bound):
            found = self._search(positives, limits, bound)
            if found is not None:
                best, bound = found, len(found)
        return best if best is not None and (limit is None or len(best) < limit) else None

    def _among_literals(self) -> str | None:
        """Decide every word that a pattern names exactly."""
        permit = [Evaluator(each) for each in self._permitting]
        refuse = Evaluator(self._refusing)
        texts: set[str] = set().union(*(each.named for each in (*permit, refuse)))
        return shortest(
            text
            for text in texts
            if all(each.permits(text) for each in permit) and not refuse.permits(text) and text in self._universe
        )

    def _cubes(self, bound: int | None) -> Iterator[tuple[list[Glob], list[Limit]]]:
        """Yield cubes of words that no pattern names exactly: positive patterns, and those that must not match.

        Cubes without a word that is shorter than the bound may be left out.
        """
        for chosen in self._chosen(0, ()):
            allowed = [side.pattern for side in chosen]
            limits = [(own, side.unless) for own, side in zip(self._allowing, chosen, strict=True)]
            yield allowed, [*limits, (self._denying, len(self._refusing))]
            for refused in self._denials(chosen, bound):
                yield [*allowed, refused.pattern], [*limits, (self._denying, refused.unless)]

    def _chosen(self, at: int, chosen: tuple[RankedPattern, ...]) -> Iterator[tuple[RankedPattern, ...]]:
        """Yield one way in which each list permits, such that all of them may permit one word."""
        if at == len(self._permitting):
            yield chosen
            return
        sides = self._allowing[at].others.near(chosen[0].pattern) if chosen else self._allowing[at].others
        for side in sides:
            self._meter()
            if not any(disjoint(side.pattern, other.pattern) for other in chosen):
                yield from self._chosen(at + 1, (*chosen, side))

    def _denials(self, chosen: Sequence[RankedPattern], bound: int | None) -> Iterator[RankedPattern]:
        """Yield the ways in which the refusing list refuses what is permitted in a way."""
        allowed = [side.pattern for side in chosen]
        for side in self._left(chosen[0].unless, bound).near(allowed[0]):
            self._meter()
            if not any(disjoint(side.pattern, each) for each in allowed):
                yield side

    def _left(self, unless: int, bound: int | None) -> Heads:
        """Return the denials that are about words that the first list does not deny anyway; found out once."""
        if unless not in self._remaining:
            limits = [(self._allowing[0], unless)]
            sides = (side for side in self._denying.others if self._search([side.pattern], limits, bound) is not None)
            self._remaining[unless] = Heads(sides)
        return self._remaining[unless]

    def _search(self, positives: Sequence[Glob], limits: Sequence[Limit], bound: int | None) -> str | None:
        """Return the shortest word that positive patterns match and no others do, if it is shorter than a bound.

        Few of the others matter as a rule. So the search begins with none, and takes in those that match what it finds:
        what it finds with some of them, and none of the rest matches, is a shortest word with all of them.
        """
        if any(patterns.has(each, blocks) for patterns, blocks in limits for each in positives):
            return None
        excluded: dict[Glob, None] = {}
        for _ in range(ROUNDS):
            word = CubeSearch(self._arena(), positives, excluded, self._meter).shortest(bound)
            if word is None:
                return None
            against = [pattern for patterns, blocks in limits for pattern in patterns.matching(word, blocks)]
            if not against:
                return word
            excluded.update(dict.fromkeys(against))
        everything = (p for patterns, blocks in limits for p in patterns.meeting(positives, blocks))
        return CubeSearch(self._arena(), positives, _thinned(everything), self._meter).shortest(bound)


Limit = tuple["_Patterns", int]
"""Patterns of which those of so many blocks, from the first, must not match."""


def _thinned(patterns: Iterable[Glob]) -> tuple[Glob, ...]:
    """Leave out words that are named exactly and that a pattern matches as well."""
    found = tuple(dict.fromkeys(patterns))
    if all(literal(pattern) is None for pattern in found):
        return found
    wild = [matcher(pattern) for pattern in found if literal(pattern) is None]
    return tuple(
        pattern for pattern in found if (text := literal(pattern)) is None or not any(matches(text) for matches in wild)
    )


class _Patterns:
    """The patterns of a list's blocks of one effect, and the ways in which its other blocks decide.

    Args:
        decisions: the list.
        allows: the effect of the blocks whose patterns are looked for.

    Attributes:
        others: the ways in which the other blocks decide words that are not named exactly.
    """

    def __init__(self, decisions: DecisionList, *, allows: bool) -> None:
        first: tuple[dict[Glob, int], dict[Glob, int]] = ({}, {})
        for at, block in enumerate(decisions):
            for pattern in block.patterns:
                first[block.allows is allows].setdefault(pattern, at)
        self._first = first[True]
        self.others = Heads(RankedPattern(p, at) for p, at in first[False].items() if literal(p) is None)

    # What only some questions need is made by the first of them.
    @cached_property
    def _index(self) -> Index:
        return Index(self._first.items())

    @cached_property
    def _wild(self) -> Heads:
        return Heads(RankedPattern(p, at) for p, at in self._first.items() if literal(p) is None)

    @cached_property
    def _literals(self) -> Heads:
        return Heads(RankedPattern(p, at) for p, at in self._first.items() if literal(p) is not None)

    def has(self, pattern: Glob, blocks: int) -> bool:
        """Tell whether a pattern itself is in the first blocks."""
        return self._first.get(pattern, blocks) < blocks

    def matching(self, word: str, blocks: int) -> Iterator[Glob]:
        """Yield the patterns of the first blocks that match a word."""
        return (pattern for pattern, at in self._index.matching(word) if at < blocks)

    def meeting(self, positives: Sequence[Glob], blocks: int) -> Iterator[Glob]:
        """Yield the patterns of the first blocks that may match a word that all the positive ones match."""
        for side in self._wild.near(positives[0]):
            if side.unless < blocks and not any(_apart(side.pattern, each) for each in positives):
                yield side.pattern
        tests = [matcher(each) for each in positives]
        for side in self._literals.beginning(_head(positives[0])):
            text = literal(side.pattern) or ""
            if side.unless < blocks and all(test(text) for test in tests):
                yield side.pattern


class Heads:
    """Patterns by the text that they begin with, in the order in which they were given."""

    def __init__(self, sides: Iterable[RankedPattern]) -> None:
        self._all = tuple(sides)
        self._by_head: dict[str, list[RankedPattern]] = {}
        for side in self._all:
            self._by_head.setdefault(_head(side.pattern), []).append(side)
        self._sorted = sorted(self._by_head)

    def __iter__(self) -> Iterator[RankedPattern]:
        return iter(self._all)

    def beginning(self, text: str) -> Iterator[RankedPattern]:
        """Yield the patterns whose head begins with a text."""
        for at in range(bisect_left(self._sorted, text), len(self._sorted)):
            if not self._sorted[at].startswith(text):
                return
            yield from self._by_head[self._sorted[at]]

    def near(self, pattern: Glob) -> Iterator[RankedPattern]:
        """Yield the patterns whose head begins another one's, or is begun by it."""
        text = _head(pattern)
        for end in range(len(text)):
            yield from self._by_head.get(text[:end], ())
        yield from self.beginning(text)


def _head(pattern: Glob) -> str:
    return pattern[0] if pattern and isinstance(pattern[0], str) else ""


def _apart(one: Glob, other: Glob) -> bool:
    """Tell whether the ends of two patterns keep them apart: quick, and not always seen."""
    tail = one[-1] if one and isinstance(one[-1], str) else ""
    tail2 = other[-1] if other and isinstance(other[-1], str) else ""
    if not (tail.endswith(tail2) or tail2.endswith(tail)):
        return True
    head, head2 = _head(one), _head(other)
    return not (head.startswith(head2) or head2.startswith(head))
