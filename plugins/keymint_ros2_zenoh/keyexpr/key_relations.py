# SPDX-License-Identifier: Apache-2.0
"""Whether a key expression includes or meets another one, as Zenoh decides it.

For a literal key both are exact: they tell whether an expression matches it. Between expressions Zenoh's inclusion is
sound, but not complete: it does not see that ``*/**/a`` includes ``**/b/a``. Access control asks for this inclusion, so
that this module follows it, and not the languages of the expressions (measured with Zenoh 1.10.2).
"""

from __future__ import annotations

from functools import lru_cache

from keymint_ros2_zenoh.keyexpr.key_expr import ANY_CHARACTERS, ANY_CHUNK, ANY_CHUNKS, VERBATIM, KeyExpr

_Chunks = tuple[str, ...]


def includes(outer: KeyExpr, inner: KeyExpr) -> bool:
    """Return whether Zenoh decides that ``outer`` matches every key that ``inner`` matches."""
    return outer.text == inner.text or _includes(outer.chunks, inner.chunks)


def intersects(left: KeyExpr, right: KeyExpr) -> bool:
    """Return whether some key matches both expressions."""
    return left.text == right.text or _intersects(left.chunks, right.chunks)


def _includes(outer: _Chunks, inner: _Chunks) -> bool:
    """Let the outer chunks read the inner ones; only ``**`` reads a ``**``."""
    positions = _skipping(outer, {0})
    for chunk in inner:
        following = set()
        for position in positions:
            if position == len(outer):
                continue
            own = outer[position]
            if own == ANY_CHUNKS:
                if not chunk.startswith(VERBATIM):
                    following.add(position)
            elif chunk != ANY_CHUNKS and _chunk_includes(own, chunk):
                following.add(position + 1)
        positions = _skipping(outer, following)
        if not positions:
            return False
    return len(outer) in positions


def _skipping(chunks: _Chunks, positions: set[int]) -> set[int]:
    """Return positions with those behind the ``**`` that they are at."""
    reached = set(positions)
    for position in positions:
        while position < len(chunks) and chunks[position] == ANY_CHUNKS:
            position += 1  # noqa: PLW2901 - in canonical form at most once
            reached.add(position)
    return reached


def _chunk_includes(outer: str, inner: str) -> bool:
    if outer == inner:
        return True
    if outer.startswith(VERBATIM) or inner.startswith(VERBATIM):
        return False
    if outer == ANY_CHUNK:
        return True
    return ANY_CHARACTERS in outer and inner != ANY_CHUNK and _text_includes(outer, inner)


@lru_cache(maxsize=1 << 14)
def _text_includes(outer: str, inner: str) -> bool:
    """Match the literal parts of ``outer`` from left to right; only its ``$*`` reads a ``$*`` of ``inner``."""
    first, *middle, last = outer.split(ANY_CHARACTERS)
    end = len(inner) - len(last)
    if len(first) > end or not (inner.startswith(first) and inner.endswith(last)):
        return False
    at = len(first)
    for part in middle:
        at = inner.find(part, at, end)
        if at < 0:
            return False
        at += len(part)
    return True


@lru_cache(maxsize=1 << 16)
def _intersects(left: _Chunks, right: _Chunks) -> bool:
    """Search the product of both lists of chunks for a pair of ends."""
    todo, seen = [(0, 0)], {(0, 0)}
    while todo:
        i, j = todo.pop()
        own = left[i] if i < len(left) else None
        other = right[j] if j < len(right) else None
        if own is None and other is None:
            return True
        steps = []
        if own == ANY_CHUNKS:
            steps.append((i + 1, j))
        if other == ANY_CHUNKS:
            steps.append((i, j + 1))
        if own is not None and other is not None and _chunks_meet(own, other):
            steps.append((i + (own != ANY_CHUNKS), j + (other != ANY_CHUNKS)))
        for step in steps:
            if step not in seen:
                seen.add(step)
                todo.append(step)
    return False


def _chunks_meet(left: str, right: str) -> bool:
    """Return whether some chunk of a key matches both."""
    if left == right:
        return True
    if left.startswith(VERBATIM) or right.startswith(VERBATIM):
        return False
    if left in (ANY_CHUNK, ANY_CHUNKS) or right in (ANY_CHUNK, ANY_CHUNKS):
        return True
    if ANY_CHARACTERS not in left:
        return ANY_CHARACTERS in right and _text_includes(right, left)
    if ANY_CHARACTERS not in right:
        return _text_includes(left, right)
    return _texts_meet(left, right)


def _texts_meet(left: str, right: str) -> bool:
    """Return whether some text matches both chunks, each of which contains ``$*``: only their ends can differ."""
    head, head2 = left.partition(ANY_CHARACTERS)[0], right.partition(ANY_CHARACTERS)[0]
    tail, tail2 = left.rpartition(ANY_CHARACTERS)[2], right.rpartition(ANY_CHARACTERS)[2]
    heads = head.startswith(head2) or head2.startswith(head)
    return heads and (tail.endswith(tail2) or tail2.endswith(tail))
