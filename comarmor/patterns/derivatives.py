"""Residuals of patterns, each of which exists once: equal ends of different patterns are one integer.

A node is a pattern that is still to be matched: an Antimirov partial derivative of those that a question is about
(V. Antimirov, "Partial derivatives of regular expressions and finite automaton constructions", 1996). Patterns are
linear, so that every derivative is an end of one.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from comarmor.patterns.decision_lists import Universe
from comarmor.patterns.glob import Glob, units
from comarmor.patterns.tokens import ANY, MAX_CODE, Charset, Star

END = 0
"""The node that matches the empty word alone."""

_PREFERRED = "abcdefghijklmnopqrstuvwxyz_ABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789/-."
"""In this order letters are tried: so that a word begins like a name wherever one of the shortest does."""


@dataclass(frozen=True, slots=True)
class _Many:
    """Any number of characters out of a set."""

    members: Charset


_Symbol = str | Charset | _Many
_EVERY = _Many(ANY)


class Derivatives:
    """Nodes, and how they go on.

    Args:
        patterns: all patterns that the alphabet must tell apart.
        universe: the words in question.
    """

    def __init__(self, patterns: Iterable[Glob], universe: Universe) -> None:
        self._ids: dict[tuple[_Symbol, int], int] = {}
        self._symbols: list[_Symbol] = [""]
        self._next: list[int] = [END]
        self.accepts: list[bool] = [True]
        self._explicit: list[frozenset[str]] = [frozenset()]
        self._steps: dict[tuple[int, str], tuple[int, ...]] = {}
        self._simulated: dict[tuple[int, int], bool] = {}
        self._nodes: dict[Glob, int] = {}
        self._distinct: dict[_Symbol, frozenset[str]] = {}
        patterns = tuple(dict.fromkeys(patterns))
        self.letters = _letters(patterns, universe)
        self._ranks = {letter: rank for rank, letter in enumerate(self.letters)}
        self.everything = self._cons(_EVERY, END)
        self._separator = universe.separator
        self.universe = END
        for at in range(universe.fields):
            if at:
                self.universe = self._cons(universe.separator, self.universe)
            self.universe = self._cons(_Many(universe.alphabet), self.universe)
            if universe.last_nonempty and not at:
                self.universe = self._cons(universe.alphabet, self.universe)

    def node(self, pattern: Glob) -> int:
        """Return the node of a pattern: one of those that the alphabet was made for."""
        found = self._nodes.get(pattern)
        if found is None:
            found = END
            for token in reversed(units(pattern)):
                found = self._cons(_EVERY if isinstance(token, Star) else token, found)
            self._nodes[pattern] = found
        return found

    def step(self, node: int, letter: str) -> tuple[int, ...]:
        """Return what is left of a node after a letter."""
        key = (node, letter)
        found = self._steps.get(key)
        if found is None:
            found = self._steps[key] = self._derive(node, letter)
        return found

    def _derive(self, node: int, letter: str) -> tuple[int, ...]:
        found: list[int] = []
        while node != END:
            symbol, following = self._symbols[node], self._next[node]
            if isinstance(symbol, _Many):
                if letter in symbol.members:
                    found.append(node)
                node = following
                continue
            if letter == symbol if isinstance(symbol, str) else letter in symbol:
                found.append(following)
            break
        # What matches every word stands for all the others.
        return (self.everything,) if self.everything in found else tuple(found)

    def steps(self, nodes: Iterable[int], letter: str) -> frozenset[int]:
        """Return what is left of any of several nodes after a letter."""
        return frozenset(after for node in nodes for after in self.step(node, letter))

    def worth_trying(self, nodes: Iterable[int]) -> list[str]:
        """Return letters so that every other letter does to these nodes what one of them does."""
        explicit: set[str] = set()
        for node in nodes:
            explicit |= self._explicit[node]
        other = next((letter for letter in self.letters if letter not in explicit), None)
        ranked = sorted(explicit, key=self._ranks.__getitem__)
        # What no pattern waits for leaves the fewest of them behind: states that are found first then stand for more.
        return ranked if other is None else [other, *ranked]

    def simulates(self, outer: int, inner: int) -> bool:
        """Tell whether one node is seen, by its shape, to match all that another does; False where it is not seen."""
        if outer in (inner, self.everything):
            return True
        key = (outer, inner)
        found = self._simulated.get(key)
        if found is None:
            found = self._simulated[key] = self._sees(outer, inner)
        return found

    def _sees(self, outer: int, inner: int) -> bool:
        """Let the wider pattern read the symbols of the narrower: forward, all the places it can be at."""
        places = self._closed((outer,))
        while inner != END:
            symbol = self._symbols[inner]
            places = self._closed(self._reading(places, symbol))
            if not places:
                return False
            inner = self._next[inner]
            if inner in places or self.everything in places:
                return True
        return END in places

    def _reading(self, places: Iterable[int], symbol: _Symbol) -> Iterable[int]:
        for place in places:
            own = self._symbols[place]
            if isinstance(own, _Many):
                if _within(symbol.members if isinstance(symbol, _Many) else symbol, own.members):
                    yield place
            elif place != END and not isinstance(symbol, _Many) and _within(symbol, own):
                yield self._next[place]

    def _closed(self, places: Iterable[int]) -> set[int]:
        found: set[int] = set()
        for place in places:
            at = place
            found.add(at)
            while isinstance(self._symbols[at], _Many):
                at = self._next[at]
                found.add(at)
        return found

    def _cons(self, symbol: _Symbol, following: int) -> int:
        key = (symbol, following)
        found = self._ids.get(key)
        if found is None:
            found = self._ids[key] = len(self._next)
            self._symbols.append(symbol)
            self._next.append(following)
            many = isinstance(symbol, _Many)
            self.accepts.append(many and self.accepts[following])
            own = self._distinguished(symbol)
            self._explicit.append(own | self._explicit[following] if many else own)
        return found

    def _distinguished(self, symbol: _Symbol) -> frozenset[str]:
        """Return letters so that the symbol does the same with all the others."""
        if isinstance(symbol, str):
            return frozenset((symbol,))
        found = self._distinct.get(symbol)
        if found is None:
            members = symbol.members if isinstance(symbol, _Many) else symbol
            inside = frozenset(letter for letter in self.letters if letter in members)
            outside = frozenset(self.letters) - inside
            found = self._distinct[symbol] = min(inside, outside, key=len)
        return found


def _within(inner: str | Charset, outer: str | Charset) -> bool:
    if isinstance(outer, str):
        return inner == outer
    if isinstance(inner, str):
        return inner in outer
    return outer == ANY or inner.intersection(outer) == inner


def _letters(patterns: Iterable[Glob], universe: Universe) -> tuple[str, ...]:
    """Return one character of each class that the patterns and the universe tell apart, legible ones first."""
    singles: set[str] = {universe.separator} if universe.fields > 1 else set()
    sets: dict[Charset, None] = {universe.alphabet: None}
    for pattern in patterns:
        for token in pattern:
            if isinstance(token, str):
                singles.update(token)
            elif isinstance(token, Charset):
                sets[token] = None
    edges = {0}
    for low, high in (pair for each in sets for pair in each.ranges):
        edges.update((low, high + 1))
    for char in singles:
        edges.update((ord(char), ord(char) + 1))
    candidates = [*_PREFERRED, *map(chr, sorted(edge for edge in edges if edge <= MAX_CODE))]
    kinds: dict[tuple[object, ...], str] = {}
    for char in candidates:
        kind = (char if char in singles else None, *(char in each for each in sets))
        kinds.setdefault(kind, char)
    return tuple(kinds.values())
