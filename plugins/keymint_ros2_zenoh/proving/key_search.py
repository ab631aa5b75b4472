# SPDX-License-Identifier: Apache-2.0
"""Compare what two sides permit, over all literal keys: a shortest key on which they differ, or none, or unknown.

A side is what applies to a link: entries, each with the patterns that it allows and denies. A key is permitted if an
entry allows it and does not deny it. Both sides are read in step, a character at a time, so that the search visits the
reachable combinations of positions in all patterns.
"""

from __future__ import annotations

import string
from collections import deque
from collections.abc import Iterable, Iterator
from functools import lru_cache

from comarmor.patterns.decision_lists import BudgetError, Equal, ProofResult, SearchBudget, Unknown, Witness
from comarmor.patterns.steps import StepLimitError, spend, step_limit
from comarmor.patterns.tokens import Charset, charset, distinct_letters
from comarmor.values import dataclass
from keymint_ros2_zenoh.keyexpr.key_expr import VERBATIM
from keymint_ros2_zenoh.proving.automaton import IN_CHUNK, START, Automaton

Nodes = frozenset[int]
Side = frozenset[tuple[Nodes, Nodes]]
"""For each entry the nodes that it allows, and those that it denies; made by :func:`side_of`."""

_LEGIBLE = string.ascii_lowercase + "_" + string.ascii_uppercase + string.digits + "/@%:-."
_LETTERS = charset((ord(char), ord(char)) for char in string.ascii_letters + "_")
"""First characters of the segments of ROS names, of types and of hashes."""

_FIRST, _IN_FIRST, _NAME, _IN_NAME, _FREE, _IN_FREE = range(6)
"""Where a word is: before or in its first chunk; in chunks of names; in a verbatim chunk or behind one."""


_SHARE = 8
"""Nodes that are followed by a character at the cost of one step."""


@dataclass(frozen=True, slots=True)
class _State:
    left: Side
    right: Side
    where: int


def difference(automaton: Automaton, left: Side, right: Side, budget: SearchBudget) -> ProofResult:
    """Compare two sides over all literal keys whose names are legal ROS names.

    The names are the chunks after the first one, up to one that begins with ``@``: they begin with a letter or ``_``.

    Returns:
        :class:`Equal`, a shortest :class:`Witness` with a key, or :class:`Unknown` if the budget was spent.
    """
    if left == right:
        return Equal()
    try:
        with step_limit(budget.steps):
            return _search(automaton, left, right, budget)
    except (BudgetError, StepLimitError) as error:
        return Unknown(str(error))


def _search(automaton: Automaton, left: Side, right: Side, budget: SearchBudget) -> ProofResult:
    count_state = budget.state_counter()
    sets = (*automaton.sets(), IN_CHUNK, START, _LETTERS)
    start = _State(left, right, _FIRST)
    seen, todo = {start}, deque([(start, "")])
    while todo:
        state, word = todo.popleft()
        count_state()
        if state.where in (_NAME, _FREE):
            permitted = _permits(automaton, state.left)
            if permitted is not _permits(automaton, state.right):
                return Witness(word[:-1], permitted)
        nodes = tuple(_nodes(state))
        for char in _letters(automaton.explicit(nodes), sets):
            where = _next(state.where, char)
            if where is None:
                continue
            spend(1 + len(nodes) // _SHARE)
            following = _State(_step(automaton, state.left, char), _step(automaton, state.right, char), where)
            if following.left != following.right and following not in seen:
                seen.add(following)
                todo.append((following, word + char))
    return Equal()


def _nodes(state: _State) -> Iterator[int]:
    for allowed, denied in (*state.left, *state.right):
        yield from allowed
        yield from denied


def side_of(entries: Iterable[tuple[Nodes, Nodes]]) -> Side:
    """Return a side; entries that deny the same become one, and one that allows nothing that is left is left out."""
    together: dict[Nodes, Nodes] = {}
    for allowed, denied in entries:
        if permitted := allowed - denied:
            together[denied] = together.get(denied, frozenset()) | permitted
    return frozenset((allowed, denied) for denied, allowed in together.items())


def _step(automaton: Automaton, side: Side, char: str) -> Side:
    """Return the side after a character."""
    after = ((automaton.step(allowed, char), automaton.step(denied, char)) for allowed, denied in side)
    return side_of((automaton.beside(allowed, denied), automaton.beside(denied)) for allowed, denied in after)


def _permits(automaton: Automaton, side: Side) -> bool:
    return any(
        any(map(automaton.accepts, allowed)) and not any(map(automaton.accepts, denied)) for allowed, denied in side
    )


def _next(where: int, char: str) -> int | None:
    """Return where a word is after a character; None if no key of the universe goes on so."""
    if char == "/":
        return {_IN_FIRST: _NAME, _IN_NAME: _NAME, _IN_FREE: _FREE}.get(where)
    if char not in IN_CHUNK:
        return None
    if where in (_FREE, _IN_FREE) or (where in (_FIRST, _NAME) and char == VERBATIM):
        return _IN_FREE
    if where in (_FIRST, _IN_FIRST):
        return _IN_FIRST
    return _IN_NAME if where == _IN_NAME or char in _LETTERS else None


@lru_cache(maxsize=1 << 12)
def _letters(explicit: frozenset[str], sets: tuple[Charset, ...]) -> tuple[str, ...]:
    """Return the characters to try: those that patterns mention, and one other of each class that sets distinguish."""
    return distinct_letters(set(explicit), sets, _LEGIBLE)
