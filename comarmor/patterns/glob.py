"""Expressions as data: POSIX ``fnmatch`` patterns parsed into tuples of tokens.

The semantics are those of ``fnmatch()`` without flags (IEEE Std 1003.1, 2.13) in the C locale over code points:
``*`` and ``?`` also match ``/`` and a leading ``.``, a backslash escapes, and a ``[`` that opens no complete bracket
expression is itself.

A :data:`Glob` is normalised: runs of literal characters are one string, sets of one character are literals, and in
a run of ``*`` and ``?`` the ``?`` come first and one ``*`` last. Equal token tuples are equal languages; the reverse
need not hold.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache, lru_cache

MAX_CODE = 0x10FFFF


class GlobError(ValueError):
    """The text is not an expression; says why in one line."""


@dataclass(frozen=True, slots=True)
class Star:
    """``*``: any characters, also none."""


@dataclass(frozen=True, slots=True)
class Charset:
    """One character out of a set.

    Attributes:
        ranges: code points as closed ranges, sorted, neither touching nor overlapping.
    """

    ranges: tuple[tuple[int, int], ...]

    def __contains__(self, char: str) -> bool:
        """Tell whether a character is in the set."""
        code = ord(char)
        return any(low <= code <= high for low, high in self.ranges)

    def __len__(self) -> int:
        """Return how many characters the set has."""
        return sum(high - low + 1 for low, high in self.ranges)

    def chars(self) -> Iterator[str]:
        """Yield the characters in order of their code points."""
        for low, high in self.ranges:
            yield from map(chr, range(low, high + 1))

    def complement(self) -> Charset:
        """Return the set of all other characters."""
        edges = [-1, *(edge for pair in self.ranges for edge in pair), MAX_CODE + 1]
        gaps = ((edges[i] + 1, edges[i + 1] - 1) for i in range(0, len(edges), 2))
        return Charset(tuple((low, high) for low, high in gaps if low <= high))

    def intersection(self, other: Charset) -> Charset:
        """Return the set of the characters that both have."""
        both = ((max(low, low2), min(high, high2)) for low, high in self.ranges for low2, high2 in other.ranges)
        return Charset(tuple((low, high) for low, high in both if low <= high))


STAR = Star()
ANY = Charset(((0, MAX_CODE),))
"""``?``: any one character."""

Token = str | Charset | Star
Glob = tuple[Token, ...]
EVERYTHING: Glob = (STAR,)

_SPECIAL = re.compile(r"[*?\[\\]")
_DIGIT, _UPPER, _LOWER = (48, 57), (65, 90), (97, 122)
_CLASSES = {
    "alnum": (_DIGIT, _UPPER, _LOWER),
    "alpha": (_UPPER, _LOWER),
    "blank": ((9, 9), (32, 32)),
    "cntrl": ((0, 31), (127, 127)),
    "digit": (_DIGIT,),
    "graph": ((33, 126),),
    "lower": (_LOWER,),
    "print": ((32, 126),),
    "punct": ((33, 47), (58, 64), (91, 96), (123, 126)),
    "space": ((9, 13), (32, 32)),
    "upper": (_UPPER,),
    "xdigit": (_DIGIT, (65, 70), (97, 102)),
}
"""The character classes in the C locale (IEEE Std 1003.1, 7.3.1)."""


def charset(ranges: Iterable[tuple[int, int]]) -> Charset:
    """Return the set of the given closed ranges of code points, in any order; empty ranges do not count."""
    merged: list[tuple[int, int]] = []
    for low, high in sorted(pair for pair in ranges if pair[0] <= pair[1]):
        if merged and low <= merged[-1][1] + 1:
            merged[-1] = (merged[-1][0], max(high, merged[-1][1]))
        else:
            merged.append((low, high))
    return Charset(tuple(merged))


@lru_cache(maxsize=1 << 14)
def parse(expression: str) -> Glob:
    """Return the tokens of an expression.

    Raises:
        GlobError: a lone backslash at the end, an unknown character class, or an equivalence class or collating
            element, which have no meaning in the C locale.
    """
    if not _SPECIAL.search(expression):
        return (expression,) if expression else ()
    tokens: list[Token] = []
    at, end = 0, len(expression)
    while at < end:
        char = expression[at]
        at += 1
        if char == "*":
            tokens.append(STAR)
        elif char == "?":
            tokens.append(ANY)
        elif char == "\\":
            if at == end:
                raise GlobError(f"the expression {expression!r} ends in a backslash that escapes nothing")
            tokens.append(expression[at])
            at += 1
        elif char == "[" and (found := _bracket(expression, at)):
            members, at = found
            tokens.append(members)
        else:
            tokens.append(char)
    return normalise(tokens)


def _bracket(expression: str, at: int) -> tuple[Charset, int] | None:
    """Return the set of a bracket expression whose ``[`` ends at ``at``, and where it ends; None if it does not."""
    negated = expression[at : at + 1] in {"!", "^"}  # POSIX leaves "^" open; the C libraries negate
    at += negated
    ranges: list[tuple[int, int]] = []
    first = True
    while at < len(expression):
        char = expression[at]
        if char == "]" and not first:
            members = charset(ranges)
            return (members.complement() if negated else members), at + 1
        first = False
        if char == "[" and expression[at + 1 : at + 2] in {":", ".", "="}:
            close = expression.find(expression[at + 1] + "]", at + 2)
            if close >= 0:
                ranges.extend(_named(expression, expression[at + 1], expression[at + 2 : close]))
                at = close + 2
                continue
        low, at = _member(expression, at)
        if expression[at : at + 1] == "-" and expression[at + 1 : at + 2] not in ("", "]"):
            high, at = _member(expression, at + 1)
            ranges.append((ord(low), ord(high)))
        else:
            ranges.append((ord(low), ord(low)))
    return None


def _named(expression: str, mark: str, name: str) -> tuple[tuple[int, int], ...]:
    """Return the ranges of ``[:name:]``."""
    if mark != ":":
        raise GlobError(f"the expression {expression!r} has an equivalence class or collating element")
    if name not in _CLASSES:
        known = ", ".join(_CLASSES)
        raise GlobError(f"the expression {expression!r} has an unknown class [:{name}:]; the classes are {known}")
    return _CLASSES[name]


def _member(expression: str, at: int) -> tuple[str, int]:
    """Return one end of a range, which a backslash may escape, and where it ends."""
    if expression[at] == "\\" and at + 1 < len(expression):
        return expression[at + 1], at + 2
    return expression[at], at + 1


def normalise(tokens: Iterable[Token]) -> Glob:
    """Return tokens in the normal form (see the module)."""
    out: list[Token] = []
    star = False
    for token in tokens:
        if isinstance(token, Star):
            star = True
            continue
        if isinstance(token, Charset) and len(token) == 1:
            token = next(token.chars())  # noqa: PLW2901 - a set of one character is that character
        if star and token != ANY:
            out.append(STAR)
            star = False
        if isinstance(token, str) and out and isinstance(out[-1], str):
            out[-1] += token
        elif token != "":
            out.append(token)
    if star:
        out.append(STAR)
    return tuple(out)


def literal(glob: Glob) -> str | None:
    """Return the one name that a glob matches, or None when it may match others or none."""
    if not glob:
        return ""
    return glob[0] if len(glob) == 1 and isinstance(glob[0], str) else None


def is_empty(glob: Glob) -> bool:
    """Tell whether a glob matches no name at all, as ``[b-a]`` does."""
    return literal(glob) is None and any(isinstance(token, Charset) and not token.ranges for token in glob)


def surround(prefix: str, glob: Glob, suffix: str) -> Glob:
    """Return the glob of the names ``prefix + name + suffix``."""
    text = literal(glob)
    if text is not None:
        whole = prefix + text + suffix
        return (whole,) if whole else ()
    return normalise((prefix, *glob, suffix))


@cache
def units(glob: Glob) -> tuple[Token, ...]:
    """Return a glob with its literal runs split into single characters."""
    out: list[Token] = []
    for token in glob:
        if isinstance(token, str):
            out.extend(token)
        else:
            out.append(token)
    return tuple(out)


def after(glob: Glob, prefix: str) -> tuple[Glob, ...]:
    """Return what is left of a glob after it consumed a prefix: its Antimirov partial derivatives.

    The union of the results is exactly the set of the names ``n`` for which the glob matches ``prefix + n``
    (V. Antimirov, "Partial derivatives of regular expressions", 1996).
    """
    text = literal(glob)
    if text is not None:
        rest = text[len(prefix) :]
        return ((rest,) if rest else (),) if text.startswith(prefix) else ()
    left = {units(glob)}
    for char in prefix:
        left = {rest for tokens in left for rest in _derive(tokens, char)}
    return tuple(dict.fromkeys(normalise(tokens) for tokens in sorted(left, key=len)))


def _derive(tokens: tuple[Token, ...], char: str) -> Iterator[tuple[Token, ...]]:
    for at, token in enumerate(tokens):
        if isinstance(token, Star):
            yield tokens[at:]
            continue
        if (token == char) if isinstance(token, str) else (char in token):
            yield tokens[at + 1 :]
        return
