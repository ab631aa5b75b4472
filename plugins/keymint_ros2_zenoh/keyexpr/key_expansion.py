# SPDX-License-Identifier: Apache-2.0
"""From ``fnmatch`` expressions over ROS names to key expressions that match the same names.

The leading ``/`` of a name is left out. A ``*`` between characters of segments stands for characters of one segment
(``$*``), or for text that contains a ``/`` (``$*/**/$*``). At the border of a segment one expression covers both.
A ``?`` or a bracket expression has no counterpart: it is enumerated over the characters of ROS names.
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
from keymint_ros2_zenoh.keyexpr.key_expr import ANY_CHUNK, ANY_CHUNKS, KeyExpr, canonical, of_chunks
from keymint_ros2_zenoh.keyexpr.key_relations import includes

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
