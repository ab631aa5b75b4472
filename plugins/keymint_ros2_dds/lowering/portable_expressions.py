# SPDX-License-Identifier: Apache-2.0
"""Portable expressions: how to write a pattern in a document so that every DDS vendor matches the same names.

Cyclone DDS matches with a function of its own, Fast DDS with ``fnmatch(FNM_NOESCAPE)``. They agree on literals, ``*``
and ``?``, but not on bracket expressions: Cyclone DDS lets each of them match ``]`` as well, and misreads one that is
followed by ``-``. Neither has escapes, but in the standard and OpenDDS a backslash escapes, so no backslash is ever
written. Small sets become alternatives, and the complement of a small set becomes a bracket expression with the
alternative ``]``. Names are assumed to be ASCII, as DDS topic names are.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import lru_cache
from itertools import pairwise, product
from math import prod

from comarmor.patterns.glob import Glob, literal, parse
from comarmor.patterns.tokens import ANY, SPECIAL, STAR, Charset, Star
from keymint_ros2_dds.lowering.lowered_rules import Partitions

MAX_ALTERNATIVES = 64
"""Expressions that one pattern may become."""

_ASCII = Charset(((0, 127),))
_TRAPS = "\\]"


class NotPortableError(Exception):
    """No expression is portable across DDS vendors; the message has the reason and the vendors that differ."""


Step = tuple[Glob, Partitions]
"""A step of a decision list: topics that match are allowed in these partitions; denied in all, if there are none."""


class UnportableError(Exception):
    """Rules cannot be expressed portably across DDS vendors.

    Attributes:
        code: ``portability-partition`` or ``portability-order``.
        pattern: the topic pattern.
        reason: one line.
    """

    def __init__(self, pattern: Glob, reason: str, code: str = "portability-partition") -> None:
        self.code = code
        self.pattern = pattern
        self.reason = reason
        super().__init__(reason)


def unsafe(allow: Iterable[Step]) -> Iterator[tuple[Glob, str]]:
    """Yield the patterns whose partitions are not portable across DDS vendors, each with the reason.

    Vendors compare an endpoint's own wildcard as text, so an endpoint in ``p*`` would match ``p?`` and receive more
    than ``p?`` allows. A single ``*`` is safe: whatever wildcard it matches, the endpoint receives no more than that.
    """
    for pattern, partitions in allow:
        for expression in partitions:
            glob = parse(expression)
            text = literal(glob)
            if text is None and not (glob.count(STAR) == 1 and all(isinstance(each, str | Star) for each in glob)):
                why = "vendors compare an endpoint's own wildcard with it as text"
                yield pattern, f"the partition {expression!r} is neither a name nor one with a single '*', and {why}"
            elif any(_misread(part) for part in glob if isinstance(part, str)):
                yield pattern, f"the partition {expression!r} has characters that vendors read differently"


def _misread(text: str) -> bool:
    return any(char in "*?[]\\" or not " " <= char <= "~" for char in text) or text != text.strip()


@lru_cache(maxsize=1 << 14)
def portable_expressions(glob: Glob) -> tuple[str, ...]:
    """Return the expressions that together match exactly what a pattern matches, on every vendor.

    Raises:
        NotPortableError: there are none, e.g. for a name with a literal ``*``.
    """
    text = literal(glob)
    if text is not None:
        return (_literal(text),)
    choices = [_choices(token) for token in glob]
    if prod(map(len, choices)) > MAX_ALTERNATIVES:
        raise NotPortableError(f"a bracket expression stands for more than {MAX_ALTERNATIVES} alternatives")
    for before, following in pairwise(choices):
        if any(part.startswith("-") for part in following) and any(part.startswith("[") for part in before):
            raise NotPortableError("a bracket expression is followed by '-', which Cyclone DDS misreads")
    expressions = tuple("".join(parts) for parts in product(*choices))
    for expression in expressions:
        _check_ends(expression)
    return expressions


def _literal(text: str) -> str:
    if SPECIAL.search(text) or not (text.isascii() and text.isprintable()):
        char = next(char for char in text if char in "*?[\\" or not " " <= char <= "~")
        if char in "*?[\\":
            why = "for which the standard and the vendors have no common escape"
            raise NotPortableError(f"the name has a literal {char!r}, {why}")
        raise NotPortableError(f"the name has the character {char!r}, which is not printable ASCII")
    _check_ends(text)
    return text


def _check_ends(text: str) -> None:
    if text != text.strip():
        raise NotPortableError("the name begins or ends with a blank, which Cyclone DDS trims")


def _choices(token: str | Charset | Star) -> list[str]:
    if isinstance(token, Star):
        return ["*"]
    if isinstance(token, str):
        _literal(f"x{token}x")
        return [token]
    if token == ANY:
        return ["?"]
    if len(token) <= MAX_ALTERNATIVES:
        return [_literal(f"x{char}x")[1:-1] for char in token.chars()]
    excluded = token.complement().intersection(_ASCII)
    if len(excluded) > MAX_ALTERNATIVES or token.ranges[-1][1] != ANY.ranges[0][1]:
        what = f"a bracket expression holds more than {MAX_ALTERNATIVES} characters"
        raise NotPortableError(f"{what}, and on Cyclone DDS ']' matches it too")
    if unsafe := next((char for char in token.complement().chars() if not " " <= char <= "~"), None):
        raise NotPortableError(f"a bracket expression leaves out {unsafe!r}, which is not printable ASCII")
    for char in _TRAPS:
        if char in excluded:
            raise NotPortableError(f"a bracket expression leaves out {char!r}, which vendors read differently there")
    # Every member is a range, so that no character has a second meaning. Cyclone DDS leaves out the "]" as well.
    return ["[!" + "".join(f"{chr(low)}-{chr(high)}" for low, high in excluded.ranges) + "]", "]"]
