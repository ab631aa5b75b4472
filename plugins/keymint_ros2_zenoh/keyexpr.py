# SPDX-License-Identifier: Apache-2.0
"""Key expressions of Zenoh: their notation, how two of them relate, and those that match what ``fnmatch`` matches.

A key expression is a list of chunks with ``/`` between them. The chunk ``*`` matches one chunk of a key, ``**`` any
number of them, none included, and ``$*`` within a chunk any characters of it. Chunks that begin with ``@`` are
verbatim: no ``*`` or ``**`` matches them. Zenoh accepts canonical expressions only (Zenoh RFC "Key Expressions";
measured with Zenoh 1.10.2).

:func:`includes` and :func:`intersects` decide as Zenoh does. For a literal key both are exact: they tell whether an
expression matches it. Between expressions Zenoh's inclusion is sound, but not complete: it does not see that ``*/**/a``
includes ``**/b/a``. Access control asks for this inclusion, so that they follow it, and not the languages of the
expressions (measured with Zenoh 1.10.2).

:func:`key_exprs` makes key expressions of ``fnmatch`` expressions over ROS names. The leading ``/`` of a name is left
out. A ``*`` between characters of segments stands for characters of one segment (``$*``), or for text that contains a
``/`` (``$*/**/$*``). At the border of a segment one expression covers both. A ``?`` or a bracket expression has no
counterpart: it is enumerated over the characters of ROS names.
"""

from __future__ import annotations

import string
from collections.abc import Iterable, Iterator
from functools import lru_cache
from itertools import islice, pairwise, product

from comarmor.patterns import glob
from comarmor.patterns.glob import Glob
from comarmor.patterns.possible_names import matches_ros_name
from comarmor.patterns.tokens import Charset, Star, Token
from comarmor.text import lazy_regex
from comarmor.values import Data, field

ANY_CHUNK = "*"
ANY_CHUNKS = "**"
ANY_CHARACTERS = "$*"
"""Any characters within a chunk."""
VERBATIM = "@"
"""Beginning of a chunk that no ``*`` or ``**`` matches."""
_FORBIDDEN = lazy_regex(r"[#?]")
_PLAIN = lazy_regex(r"(?:[^*$#?/]|\$\*)+")
_REPEATED = lazy_regex(r"(?:\$\*){2,}")


class KeyExprError(ValueError):
    """The text is not a key expression; the message says why, in one line."""


class KeyExpr(Data, order=True):
    """A canonical key expression; made by :func:`parse` and :func:`canonical`.

    Attributes:
        text: the expression.
        chunks: its chunks.
    """

    text: str
    chunks: tuple[str, ...] = field(compare=False, repr=False)

    def __str__(self) -> str:
        """Return the expression."""
        return self.text

    @property
    def is_literal(self) -> bool:
        """Whether it matches exactly one key, its own text."""
        return "*" not in self.text


@lru_cache(maxsize=1 << 16)
def parse(text: str) -> KeyExpr:
    """Return a key expression that is in canonical form, as Zenoh requires of a configuration.

    Raises:
        KeyExprError: the text is no key expression, or is not canonical.
    """
    expression = canonical(text)
    if expression.text != text:
        raise KeyExprError(f"the key expression {text!r} is not in canonical form, which is {expression.text!r}")
    return expression


def canonical(text: str) -> KeyExpr:
    """Return the canonical form of a key expression.

    Raises:
        KeyExprError: the text is no key expression.
    """
    return of_chunks(text.split("/"))


def literal(text: str) -> KeyExpr | None:
    """Return the key expression that matches one key only, this text; None if no key is written so."""
    try:
        key = canonical(text)
    except KeyExprError:
        return None
    return key if key.is_literal else None


def of_chunks(chunks: Iterable[str]) -> KeyExpr:
    """Return the canonical key expression of chunks.

    Raises:
        KeyExprError: a chunk is empty or illegal.
    """
    result: list[str] = []
    skips = False  # a "**" is due: it stands after the "*" that follow it
    for each in chunks:
        chunk = _canonical_chunk(each)
        if chunk == ANY_CHUNKS:
            skips = True
            continue
        if skips and chunk != ANY_CHUNK:
            result.append(ANY_CHUNKS)
            skips = False
        result.append(chunk)
    if skips:
        result.append(ANY_CHUNKS)
    return KeyExpr("/".join(result), tuple(result))


def _canonical_chunk(chunk: str) -> str:
    if chunk in (ANY_CHUNK, ANY_CHUNKS):
        return chunk
    if not chunk:
        raise KeyExprError("a key expression has no empty chunk: neither '//' nor a '/' at its beginning or end")
    if match := _FORBIDDEN.search(chunk):
        raise KeyExprError(f"a key expression has no {match[0]!r}")
    if not _PLAIN.fullmatch(chunk):
        raise KeyExprError(f"in the chunk {chunk!r}, '*' must stand alone or follow a '$', and '$' must precede a '*'")
    chunk = _REPEATED.sub("$*", chunk)
    return ANY_CHUNK if chunk == ANY_CHARACTERS else chunk


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
    # Each contains "$*", so that only their ends can differ.
    head, head2 = left.partition(ANY_CHARACTERS)[0], right.partition(ANY_CHARACTERS)[0]
    tail, tail2 = left.rpartition(ANY_CHARACTERS)[2], right.rpartition(ANY_CHARACTERS)[2]
    heads = head.startswith(head2) or head2.startswith(head)
    return heads and (tail.endswith(tail2) or tail2.endswith(tail))


MAX_ALTERNATIVES = 256
"""Key expressions that one pattern may become."""
ALPHABET = tuple(string.ascii_letters + string.digits + "_/")
"""The characters of ROS names."""


class TooManyAlternativesError(Exception):
    """A pattern stands for more key expressions than are allowed."""

    def __init__(self) -> None:
        super().__init__(f"it stands for more than {MAX_ALTERNATIVES} key expressions")


@lru_cache(maxsize=1 << 14)
def key_exprs(pattern: Glob) -> tuple[KeyExpr, ...]:
    """Return the key expressions that match a ROS name without its leading ``/`` exactly where a pattern matches it.

    None includes another one. A pattern that matches no ROS name gives none.

    Raises:
        TooManyAlternativesError: there are more than :data:`MAX_ALTERNATIVES`.
    """
    texts = (text for one in _without_sets(pattern) for rest in glob.left_quotient(one, "/") for text in _texts(rest))
    found = list(islice(texts, MAX_ALTERNATIVES + 1))
    if len(found) > MAX_ALTERNATIVES:
        raise TooManyAlternativesError
    return maximal(_merged(set(map(canonical, found))))


def _without_sets(pattern: Glob) -> Iterator[Glob]:
    """Yield the patterns that a pattern becomes when its sets are enumerated, without those that match no ROS name."""
    choices: list[tuple[Token, ...]] = []
    count = 1
    for token in pattern:
        if isinstance(token, Charset):
            choices.append(tuple(char for char in ALPHABET if char in token))
            count *= len(choices[-1])
            if count > MAX_ALTERNATIVES:
                raise TooManyAlternativesError
        else:
            choices.append((token,))
    for tokens in product(*choices):
        plain = glob.normalise(tokens)
        if matches_ros_name(plain):
            yield plain


def _texts(rest: Glob) -> Iterator[str]:
    """Yield the key expressions of the rest of a name, not yet canonical."""
    choices = [
        _stars(rest[:at], rest[at + 1 :]) if isinstance(token, Star) else (str(token),) for at, token in enumerate(rest)
    ]
    for parts in product(*choices):
        text = "".join(parts)
        if text and "//" not in text and not text.startswith("/") and not text.endswith("/"):
            yield text


def _stars(before: Glob, behind: Glob) -> tuple[str, ...]:
    """Return what a ``*`` becomes: it depends on whether a segment begins before it, and ends behind it."""
    begins = not before or glob.suffix(before).endswith("/")
    ends = not behind or glob.prefix(behind).startswith("/")
    if begins:
        return ("*/**",) if ends else ("**/$*",)
    return ("$*/**",) if ends else ("$*", "$*/**/$*")


def _merged(expressions: set[KeyExpr]) -> set[KeyExpr]:
    """Return fewer key expressions that match the same keys: ``a/b`` and ``a/*/**/b`` become ``a/**/b``."""
    merged = set(expressions)
    todo = sorted(expressions)
    while todo:
        each = todo.pop()
        chunks = each.chunks
        for at, pair in enumerate(pairwise(chunks)):
            shorter = of_chunks((*chunks[:at], *chunks[at + 2 :])) if pair == (ANY_CHUNK, ANY_CHUNKS) else None
            if shorter in merged:
                wider = of_chunks((*chunks[:at], *chunks[at + 1 :]))
                merged = (merged - {each, shorter}) | {wider}
                todo.append(wider)
                break
    return merged


def maximal(expressions: Iterable[KeyExpr]) -> tuple[KeyExpr, ...]:
    """Return key expressions, sorted, without those that another one includes."""
    distinct = sorted(set(expressions))
    wild = [each for each in distinct if not each.is_literal]
    return tuple(each for each in distinct if not any(other is not each and includes(other, each) for other in wild))
