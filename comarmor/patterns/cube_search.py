# SPDX-License-Identifier: Apache-2.0
"""Search one cube, the words that some patterns match and none of some others: breadth first, with antichains.

A state is one position in each positive pattern, and the set of positions that the excluded patterns can be in. Of two
states with the same positive positions, the one with fewer excluded positions accepts all words of the other (M. De
Wulf et al., "Antichains: a new algorithm for checking universality of finite automata", 2006).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from itertools import product

from comarmor.patterns.derivatives import Derivatives
from comarmor.patterns.glob import Glob
from comarmor.patterns.steps import spend

_Nodes = tuple[int, ...]
_State = tuple[_Nodes, frozenset[int]]


class CubeSearch:
    """Searches one cube.

    Args:
        derivatives: derivatives of the patterns.
        positives: patterns that must match.
        excluded: patterns that must not match.
        count_state: called for every state; raises :class:`comarmor.patterns.decision_lists.BudgetError`.
    """

    def __init__(
        self,
        derivatives: Derivatives,
        positives: Iterable[Glob],
        excluded: Iterable[Glob],
        count_state: Callable[[], None],
    ) -> None:
        self._derivatives = derivatives
        self._count_state = count_state
        self._start: _State = (
            (derivatives.universe, *(derivatives.node(pattern) for pattern in dict.fromkeys(positives))),
            frozenset(derivatives.node(pattern) for pattern in excluded),
        )
        self._seen: dict[_Nodes, list[frozenset[int]]] = {}

    def shortest(self, limit: int | None) -> str | None:
        """Return the shortest word of the cube that is shorter than a limit, or None."""
        accepts = self._derivatives.accepts
        level: list[tuple[_State, str]] = [(self._start, "")] if self._is_new(self._start) else []
        length = 0
        while level and (limit is None or length < limit):
            for (positives, excluded), word in level:
                if all(accepts[node] for node in positives) and not any(accepts[node] for node in excluded):
                    return word
            level = list(self._successors(level))
            length += 1
        return None

    def _successors(self, level: Iterable[tuple[_State, str]]) -> Iterator[tuple[_State, str]]:
        derivatives = self._derivatives
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
        self._count_state()
        positives, excluded = state
        includes = self._derivatives.includes
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
