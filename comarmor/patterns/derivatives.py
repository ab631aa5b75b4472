# SPDX-License-Identifier: Apache-2.0
"""Partial derivatives of patterns, hash-consed: equal rests of different patterns are one integer.

A node is the rest of a pattern that is still to be matched (V. Antimirov, "Partial derivatives of regular expressions
and finite automaton constructions", 1996). Patterns are linear, so that every derivative is a suffix of one.

:class:`CubeSearch` searches one cube, the words that some patterns match and none of some others: breadth first, with
antichains. A state is one position in each positive pattern, and the set of positions that the excluded patterns can be
in. Of two states with the same positive positions, the one with fewer excluded positions accepts all words of the other
(M. De Wulf et al., "Antichains: a new algorithm for checking universality of finite automata", 2006).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cache, partial
from itertools import product

from comarmor.patterns.decision_lists import Universe
from comarmor.patterns.glob import Glob, units
from comarmor.patterns.steps import spend
from comarmor.patterns.tokens import ANY, Charset, Star, distinct_letters
from comarmor.values import Data, field

END = 0
"""The node that matches only the empty word."""

_PREFERRED = "abcdefghijklmnopqrstuvwxyz_ABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789/-."
"""Letters are tried in this order, so that counterexamples look like names where possible."""


class _Repeat(Data):
    """Any number of characters of a set."""

    members: Charset


_Symbol = str | Charset | _Repeat
_EVERY = _Repeat(ANY)


class Derivatives:
    """Nodes and their derivatives.

    Args:
        patterns: all patterns of the question: letters that no pattern distinguishes share a representative.
        universe: the words of the question.

    Attributes:
        letters: one letter of each class that the patterns and the universe distinguish.
        accepts: for each node, whether it matches the empty word.
        everything: the node that matches every word.
        universe: the node that matches the words of the universe.
        step: returns the derivatives of a node by a letter.
    """

    def __init__(self, patterns: Iterable[Glob], universe: Universe) -> None:
        self._ids: dict[tuple[_Symbol, int], int] = {}
        self._symbols: list[_Symbol] = [""]
        self._next: list[int] = [END]
        self.accepts: list[bool] = [True]
        self._shortest: list[int] = [0]
        """The length of a shortest word of each node."""
        self._repeats_last: list[bool] = [False]
        """For each node, whether its last symbol is a repetition."""
        self._explicit: list[frozenset[str]] = [frozenset()]
        self._included: dict[tuple[int, int], bool] = {}
        self._nodes: dict[Glob, int] = {}
        self._distinguished: dict[_Symbol, frozenset[str]] = {}
        tokens = dict.fromkeys(token for pattern in dict.fromkeys(patterns) for token in pattern)
        singles = {char for token in tokens if isinstance(token, str) for char in token}
        if universe.fields > 1:
            singles.add(universe.separator)
        sets = [universe.alphabet, *(token for token in tokens if isinstance(token, Charset))]
        self.letters = distinct_letters(singles, sets, _PREFERRED)
        self._ranks = {letter: rank for rank, letter in enumerate(self.letters)}
        self.everything = self._cons(_EVERY, END)
        self.step = cache(partial(_derivatives, self._symbols, self._next, self.everything))
        self.universe = END
        for number in range(universe.fields):
            if number:
                self.universe = self._cons(universe.separator, self.universe)
            self.universe = self._cons(_Repeat(universe.alphabet), self.universe)
            if universe.last_nonempty and not number:
                self.universe = self._cons(universe.alphabet, self.universe)

    def node(self, pattern: Glob) -> int:
        """Return the node of one of the patterns."""
        node = self._nodes.get(pattern)
        if node is None:
            node = END
            for token in reversed(units(pattern)):
                node = self._cons(_EVERY if isinstance(token, Star) else token, node)
            self._nodes[pattern] = node
        return node

    def steps(self, nodes: Iterable[int], letter: str) -> frozenset[int]:
        """Return the derivatives of all nodes by a letter."""
        return frozenset(after for node in nodes for after in self.step(node, letter))

    def letters_to_try(self, nodes: Iterable[int]) -> list[str]:
        """Return letters such that every other letter has the same derivatives of these nodes as one of them."""
        explicit: set[str] = set().union(*[self._explicit[node] for node in nodes])
        other = next((letter for letter in self.letters if letter not in explicit), None)
        ranked = sorted(explicit, key=self._ranks.__getitem__)
        # A letter that no pattern names leaves the fewest excluded positions: such states subsume more of the others.
        return ranked if other is None else [other, *ranked]

    def includes(self, outer: int, inner: int) -> bool:
        """Sound, incomplete inclusion test: False means unknown."""
        if outer in (inner, self.everything):
            return True
        key = (outer, inner)
        included = self._included.get(key)
        if included is None:
            included = self._included[key] = self._is_included(outer, inner)
        return included

    def _is_included(self, outer: int, inner: int) -> bool:
        """Let the outer pattern read the symbols of the inner one, and follow all positions that it can be in."""
        if self._shortest[outer] > self._shortest[inner]:
            return False
        if self._repeats_last[inner] and not self._repeats_last[outer]:
            return False
        nodes = self._closure((outer,))
        while inner != END:
            symbol = self._symbols[inner]
            nodes = self._closure(self._read(nodes, symbol))
            if not nodes:
                return False
            inner = self._next[inner]
            if inner in nodes or self.everything in nodes:
                return True
        return END in nodes

    def _read(self, nodes: Iterable[int], symbol: _Symbol) -> Iterable[int]:
        for node in nodes:
            own = self._symbols[node]
            if isinstance(own, _Repeat):
                if _is_subset(symbol.members if isinstance(symbol, _Repeat) else symbol, own.members):
                    yield node
            elif node != END and not isinstance(symbol, _Repeat) and _is_subset(symbol, own):
                yield self._next[node]

    def _closure(self, nodes: Iterable[int]) -> set[int]:
        """Return the nodes and those that follow without reading a letter."""
        closure: set[int] = set()
        for node in nodes:
            following = node
            closure.add(following)
            while isinstance(self._symbols[following], _Repeat):
                following = self._next[following]
                closure.add(following)
        return closure

    def _cons(self, symbol: _Symbol, following: int) -> int:
        key = (symbol, following)
        node = self._ids.get(key)
        if node is None:
            node = self._ids[key] = len(self._next)
            self._symbols.append(symbol)
            self._next.append(following)
            repeats = isinstance(symbol, _Repeat)
            self.accepts.append(repeats and self.accepts[following])
            self._shortest.append(self._shortest[following] + (not repeats))
            self._repeats_last.append(repeats if following == END else self._repeats_last[following])
            own = self._distinguish(symbol)
            self._explicit.append(own | self._explicit[following] if repeats else own)
        return node

    def _distinguish(self, symbol: _Symbol) -> frozenset[str]:
        """Return letters such that the symbol treats all others the same."""
        if isinstance(symbol, str):
            return frozenset((symbol,))
        letters = self._distinguished.get(symbol)
        if letters is None:
            members = symbol.members if isinstance(symbol, _Repeat) else symbol
            inside = frozenset(letter for letter in self.letters if letter in members)
            outside = frozenset(self.letters) - inside
            letters = self._distinguished[symbol] = min(inside, outside, key=len)
        return letters


def _derivatives(
    symbols: Sequence[_Symbol], following: Sequence[int], everything: int, node: int, letter: str
) -> tuple[int, ...]:
    """Return the derivatives of a node by a letter, for the symbol of each node and the node after it."""
    derivatives: list[int] = []
    while node != END:
        symbol = symbols[node]
        if isinstance(symbol, _Repeat):
            if letter in symbol.members:
                derivatives.append(node)
            node = following[node]
            continue
        if letter == symbol if isinstance(symbol, str) else letter in symbol:
            derivatives.append(following[node])
        break
    # A node that matches every word makes the others redundant.
    return (everything,) if everything in derivatives else tuple(derivatives)


def _is_subset(inner: str | Charset, outer: str | Charset) -> bool:
    if isinstance(outer, str):
        return inner == outer
    if isinstance(inner, str):
        return inner in outer
    return outer == ANY or inner.intersection(outer) == inner


_Nodes = tuple[int, ...]
_State = tuple[_Nodes, frozenset[int]]


class CubeSearch(Data, frozen=False, eq=False):
    """Searches one cube.

    Attributes:
        derivatives: derivatives of the patterns.
        positives: patterns that must match.
        excluded: patterns that must not match.
        count_state: called for every state; raises :class:`comarmor.patterns.decision_lists.BudgetError`.
    """

    derivatives: Derivatives
    positives: Iterable[Glob]
    excluded: Iterable[Glob]
    count_state: Callable[[], None]
    _seen: dict[_Nodes, list[frozenset[int]]] = field(init=False, default_factory=dict)

    def shortest(self, limit: int | None) -> str | None:
        """Return the shortest word of the cube that is shorter than a limit, or None."""
        accepts, node_of = self.derivatives.accepts, self.derivatives.node
        matching = (self.derivatives.universe, *map(node_of, dict.fromkeys(self.positives)))
        start: _State = (matching, frozenset(map(node_of, self.excluded)))
        level = [(start, "")] if self._is_new(start) else []
        length = 0
        while level and (limit is None or length < limit):
            for (positives, excluded), word in level:
                if all(accepts[node] for node in positives) and not any(accepts[node] for node in excluded):
                    return word
            level = list(self._successors(level))
            length += 1
        return None

    def _successors(self, level: Iterable[tuple[_State, str]]) -> Iterator[tuple[_State, str]]:
        derivatives = self.derivatives
        for (positives, excluded), word in level:
            for letter in derivatives.letters_to_try((*positives, *excluded)):
                spend(1 + len(positives) + len(excluded) // 2)
                choices = [derivatives.step(node, letter) for node in positives]
                if not all(choices):
                    continue
                others = derivatives.steps(excluded, letter)
                if derivatives.everything in others:
                    continue
                for nodes in product(*choices):
                    if self._is_new((nodes, others)):
                        yield (nodes, others), word + letter

    def _is_new(self, state: _State) -> bool:
        """Return whether a state may accept a word that no earlier state accepts."""
        self.count_state()
        positives, excluded = state
        includes = self.derivatives.includes
        spend(len(positives) * len(excluded) // 4)
        if any(includes(outer, node) for node in positives for outer in excluded):
            return False
        minimal = self._seen.get(positives)
        if minimal is None:
            self._seen[positives] = [excluded]
            return True
        spend(len(minimal) // 4)
        if any(known <= excluded for known in minimal):
            return False
        self._seen[positives] = [*(known for known in minimal if not excluded <= known), excluded]
        return True
