"""The search of one cube: breadth first, with antichains.

The positive patterns are walked through one place at a time, and beside them the set of places that the others can be
at. Of two such states with the same positive places the one with fewer others has all the words of the other one
(M. De Wulf et al., "Antichains: a new algorithm for checking universality of finite automata", 2006).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from itertools import product

from comarmor.patterns.derivatives import Derivatives
from comarmor.patterns.glob import Glob
from comarmor.patterns.steps import spend

CountState = Callable[[], None]
"""Called for every state; raises :class:`comarmor.patterns.decision_lists.BudgetError` when the budget is spent."""


class CubeSearch:
    """The search of one cube.

    Args:
        arena: residuals of the patterns.
        positives: patterns that a word must match.
        excluded: patterns that it must not match.
        meter: called for every state.
    """

    def __init__(
        self, arena: Derivatives, positives: Iterable[Glob], excluded: Iterable[Glob], meter: CountState
    ) -> None:
        self._arena = arena
        self._meter = meter
        self._start = (arena.universe, *(arena.node(pattern) for pattern in dict.fromkeys(positives)))
        self._excluded = frozenset(arena.node(pattern) for pattern in excluded)
        self._seen: dict[tuple[int, ...], list[frozenset[int]]] = {}

    def shortest(self, limit: int | None) -> str | None:
        """Return the shortest word of the cube that is shorter than a limit, or None."""
        accepts = self._arena.accepts
        level: list[tuple[tuple[int, ...], frozenset[int], str]] = []
        length = 0
        if self._is_new(self._start, self._excluded):
            level.append((self._start, self._excluded, ""))
        while level and (limit is None or length < limit):
            for places, excluded, word in level:
                if all(accepts[place] for place in places) and not any(accepts[node] for node in excluded):
                    return word
            level = list(self._following(level))
            length += 1
        return None

    def _following(
        self, level: Iterable[tuple[tuple[int, ...], frozenset[int], str]]
    ) -> Iterator[tuple[tuple[int, ...], frozenset[int], str]]:
        arena = self._arena
        for places, excluded, word in level:
            for letter in arena.worth_trying((*places, *excluded)):
                spend(1 + len(places) + len(excluded) // 2)
                choices = [arena.step(place, letter) for place in places]
                if not all(choices):
                    continue
                others = arena.steps(excluded, letter)
                if arena.everything in others:
                    continue
                for after in product(*choices):
                    if self._is_new(after, others):
                        yield after, others, word + letter

    def _is_new(self, places: tuple[int, ...], excluded: frozenset[int]) -> bool:
        """Tell whether a state may lead to a word that no state before it leads to as soon."""
        self._meter()
        simulates = self._arena.simulates
        spend(len(places) * len(excluded) // 4)
        if any(simulates(node, place) for place in places for node in excluded):
            return False
        minimal = self._seen.get(places)
        if minimal is None:
            self._seen[places] = [excluded]
            return True
        spend(len(minimal) // 4)
        if any(known <= excluded for known in minimal):
            return False
        self._seen[places] = [*(known for known in minimal if not excluded <= known), excluded]
        return True
