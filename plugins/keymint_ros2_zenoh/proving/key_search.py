# SPDX-License-Identifier: Apache-2.0
"""Compare what two sides permit, over all literal keys: a shortest key on which they differ, or none, or unknown.

A side is what applies to a link: entries, each with the patterns that it allows and denies. A key is permitted if an
entry allows it and does not deny it. Patterns are nondeterministic automata (:class:`Automaton`) of key expressions and
of patterns of ROS names, over the characters of keys. A word is a literal key with a ``/`` behind each chunk, also the
last: so ``**`` is any number of chunks. Nodes are hash-consed: equal rests of different patterns are one integer. Both
sides are read in step, a character at a time, so that the search visits the reachable combinations of positions in all
patterns.
"""

from __future__ import annotations

import string
from collections import deque
from collections.abc import Iterable, Mapping
from functools import lru_cache

from comarmor.patterns.decision_lists import BudgetError, Equal, ProofResult, SearchBudget, Unknown, Witness
from comarmor.patterns.glob import Glob, units
from comarmor.patterns.steps import StepLimitError, spend, step_limit
from comarmor.patterns.tokens import ANY, Charset, Star, charset, distinct_letters
from comarmor.values import Data
from keymint_ros2_zenoh.keyexpr import ALPHABET, ANY_CHARACTERS, ANY_CHUNK, ANY_CHUNKS, VERBATIM, KeyExpr
from keymint_ros2_zenoh.lowering.permissions import TYPE_AND_HASH

END = 0
"""The node that accepts the empty word only."""
_ROS_SEGMENT = charset((ord(char), ord(char)) for char in ALPHABET if char != "/")
"""The characters of segments of ROS names."""


def _without(chars: str) -> Charset:
    return charset((ord(char), ord(char)) for char in chars).complement()


SYNTAX = "*$#?"
"""Characters that no literal key has."""
IN_CHUNK = _without(f"/{SYNTAX}")
START = _without(f"/{VERBATIM}{SYNTAX}")
"""First characters of chunks that are not verbatim."""


class _Node(Data):
    """A state.

    Attributes:
        chars: transitions by one character.
        sets: transitions by the characters of a set.
        accepts: whether it accepts the empty word.
    """

    chars: Mapping[str, tuple[int, ...]]
    sets: tuple[tuple[Charset, int], ...]
    accepts: bool


class Automaton:
    """Nodes of patterns; what a node accepts does not depend on the patterns that were added later.

    Attributes:
        everything: the node that accepts every word.
    """

    def __init__(self) -> None:
        self.everything = END + 1
        self._nodes = [_Node({}, (), accepts=True), _Node({}, ((ANY, self.everything),), accepts=True)]
        self._known: dict[object, int] = {}
        self._steps: dict[tuple[int, str], tuple[int, ...]] = {}
        self._together: dict[tuple[frozenset[int], str], frozenset[int]] = {}
        self._free = {END, self.everything}
        """Rests of patterns that mention no character but ``/``."""
        self._covered: dict[tuple[frozenset[int], int], bool] = {}
        self._beside: dict[tuple[frozenset[int], frozenset[int]], frozenset[int]] = {}

    def key_expr(self, expression: KeyExpr) -> int:
        """Return the node of a key expression."""
        return self._chunks(expression.chunks)

    def names(self, domain: int, rest: Glob) -> int:
        """Return the node of the keys of names.

        Args:
            domain: the domain id.
            rest: pattern of names without the leading ``/``; its sets match characters of ROS names only.
        """
        return self._text(f"{domain}/", self._rest(units(rest), starts=True))

    def accepts(self, node: int) -> bool:
        """Return whether a node accepts the empty word."""
        return self._nodes[node].accepts

    def step(self, nodes: Iterable[int], char: str) -> frozenset[int]:
        """Return the nodes that are reached by a character."""
        key = (frozenset(nodes), char)
        found = self._together.get(key)
        if found is None:
            found = self._together[key] = frozenset(after for node in key[0] for after in self._node_step(node, char))
        return found

    def beside(self, nodes: frozenset[int], others: frozenset[int] = frozenset()) -> frozenset[int]:
        """Return nodes without each that accepts nothing that one which is left, or one of others, does not accept.

        Asked are the rests of patterns that have only wildcards left. Without this, a search would distinguish which of
        many patterns a word matches, though it matches one of them however it goes on.
        """
        key = (nodes, others)
        found = self._beside.get(key)
        if found is None:
            kept = set(nodes)
            for node in sorted(nodes):
                if any(self._covers(each, node) for each in ((kept - {node}) | others) & self._free):
                    kept.remove(node)
            found = self._beside[key] = frozenset(kept)
        return found

    def _covers(self, node: int, inner: int) -> bool:
        """Return whether a node accepts all that another one does; False may also mean that it is not known."""
        start = (frozenset((node,)), inner)
        if start not in self._covered:
            seen, todo = {start}, [start]
            while todo:
                outer, inner = todo.pop()
                own = self._nodes[inner]
                if not outer or (own.accepts and not any(map(self.accepts, outer))):
                    self._covered[start] = False
                    return False
                pairs = {(self.step(outer, char), after) for char, each in own.chars.items() for after in each}
                pairs |= {(self._by_set(outer, members), after) for members, after in own.sets}
                todo += pairs - seen
                seen |= pairs
            self._covered.update(dict.fromkeys(seen, True))
        return self._covered[start]

    def _by_set(self, nodes: Iterable[int], members: Charset) -> frozenset[int]:
        """Return the nodes that each character of a set reaches."""
        own = (each for node in nodes for each in self._nodes[node].sets)
        return frozenset(after for outer, after in own if outer.intersection(members) == members)

    def explicit(self, nodes: Iterable[int]) -> frozenset[str]:
        """Return the characters that these nodes mention."""
        return frozenset(char for node in nodes for char in self._nodes[node].chars)

    def sets(self) -> tuple[Charset, ...]:
        """Return all sets of characters that nodes have."""
        return tuple(dict.fromkeys(members for node in self._nodes for members, _ in node.sets))

    def _node_step(self, node: int, char: str) -> tuple[int, ...]:
        key = (node, char)
        found = self._steps.get(key)
        if found is None:
            own = self._nodes[node]
            by_set = tuple(after for members, after in own.sets if char in members)
            found = self._steps[key] = own.chars.get(char, ()) + by_set
        return found

    def _chunks(self, chunks: tuple[str, ...]) -> int:
        if not chunks:
            return END
        key = ("chunks", chunks)
        if key not in self._known:
            first, rest = chunks[0], self._chunks(chunks[1:])
            if first == ANY_CHUNKS:
                node = self._any_text(rest, starts=True, whole=True)
            elif first == ANY_CHUNK:
                node = self._node({}, ((START, self._repeat(self._text("/", rest))),))
            else:
                node = self._chunk(first, self._text("/", rest))
            self._known[key] = node
        return self._known[key]

    def _chunk(self, chunk: str, rest: int) -> int:
        """Return the node of a chunk with text."""
        first, *parts = chunk.split(ANY_CHARACTERS)
        if parts and chunk.startswith(VERBATIM):
            return self._node({}, ())  # compared as it is, and no literal key has a "$*"
        for part in reversed(parts):
            rest = self._repeat(self._text(part, rest))
        return self._text(first, rest) if first else self._not_verbatim(rest)

    def _rest(self, tokens: tuple[str | Charset | Star, ...], *, starts: bool) -> int:
        """Return the node of the rest of a pattern of names, and of the type and hash behind it."""
        if not tokens:
            return self._text("/", self._chunks(TYPE_AND_HASH))
        first, rest = tokens[0], tokens[1:]
        if isinstance(first, Star):
            return self._any_text(self._rest(rest, starts=False), starts=starts)
        if isinstance(first, str):
            return self._text(first, self._rest(rest, starts=first == "/"))
        sets = ((first.intersection(_ROS_SEGMENT), self._rest(rest, starts=False)),)
        chars = {"/": (self._rest(rest, starts=True),)} if "/" in first else {}
        return self._node(chars, sets)

    def _text(self, text: str, rest: int) -> int:
        for char in reversed(text):
            rest = self._node({char: (rest,)}, ())
        return rest

    def _node(self, chars: Mapping[str, tuple[int, ...]], sets: tuple[tuple[Charset, int], ...]) -> int:
        """Return the node with these transitions, which does not accept the empty word."""
        key = (*chars.items(), *sets)
        if key not in self._known:
            self._known[key] = self._add(_Node(chars, sets, accepts=False))
        return self._known[key]

    def _repeat(self, rest: int) -> int:
        """Return the node of any characters of a chunk, and the rest."""
        key = ("repeat", rest)
        if key not in self._known:
            own = self._nodes[rest]
            node = len(self._nodes)
            self._known[key] = node
            self._add(_Node(own.chars, (*own.sets, (IN_CHUNK, node)), own.accepts))
        return self._known[key]

    def _not_verbatim(self, rest: int) -> int:
        """Return the node of a rest that begins within a chunk, for words whose chunk is not verbatim."""
        own = self._nodes[rest]
        chars = {char: after for char, after in own.chars.items() if char not in (VERBATIM, "/")}
        return self._node(chars, tuple((members.intersection(START), after) for members, after in own.sets))

    def _any_text(self, rest: int, *, starts: bool, whole: bool = False) -> int:
        """Return the node of any text without empty and verbatim chunks, and the rest.

        Args:
            rest: the node of the rest.
            starts: the text begins a chunk.
            whole: the text is any number of whole chunks, so that the rest begins a chunk.
        """
        key = ("any text", rest, starts, whole)
        if key not in self._known:
            own = self._nodes[rest]
            start, inside = len(self._nodes), len(self._nodes) + 1
            self._known["any text", rest, True, whole] = start
            self._known["any text", rest, False, whole] = inside
            self._add(_Node(own.chars, (*own.sets, (START, inside)), own.accepts))
            within = _Node({}, (), accepts=False) if whole else own
            slash = {**within.chars, "/": (*within.chars.get("/", ()), start)}
            self._add(_Node(slash, (*within.sets, (IN_CHUNK, inside)), within.accepts))
        return self._known[key]

    def _add(self, node: _Node) -> int:
        """Return the number of a new node; those that it mentions, and that do not exist yet, lead back to it."""
        following = {after for each in node.chars.values() for after in each} | {after for _, after in node.sets}
        if node.chars.keys() <= {"/"} and all(each in self._free or each >= len(self._nodes) for each in following):
            self._free.add(len(self._nodes))
        self._nodes.append(node)
        return len(self._nodes) - 1


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
    start = (left, right, _FIRST)
    seen, todo = {start}, deque([(start, "")])
    while todo:
        (left, right, where), word = todo.popleft()
        count_state()
        if where in (_NAME, _FREE):
            permitted = _permits(automaton, left)
            if permitted is not _permits(automaton, right):
                return Witness(word[:-1], permitted)
        nodes = [node for entry in (*left, *right) for side in entry for node in side]
        for char in _letters(automaton.explicit(nodes), sets):
            after = _next(where, char)
            if after is None:
                continue
            spend(1 + len(nodes) // _SHARE)
            following = (_step(automaton, left, char), _step(automaton, right, char), after)
            if following[0] != following[1] and following not in seen:
                seen.add(following)
                todo.append((following, word + char))
    return Equal()


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
