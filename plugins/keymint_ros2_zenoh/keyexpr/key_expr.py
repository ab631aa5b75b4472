# SPDX-License-Identifier: Apache-2.0
"""Key expressions in canonical form.

A key expression is a list of chunks with ``/`` between them. The chunk ``*`` matches one chunk of a key, ``**`` any
number of them, none included, and ``$*`` within a chunk any characters of it. Chunks that begin with ``@`` are
verbatim: no ``*`` or ``**`` matches them. Zenoh accepts canonical expressions only (Zenoh RFC "Key Expressions";
measured with Zenoh 1.10.2).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import field
from functools import lru_cache

from comarmor.regex import lazy_regex
from comarmor.values import dataclass

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


@dataclass(frozen=True, slots=True, order=True)
class KeyExpr:
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
