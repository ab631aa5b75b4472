# SPDX-License-Identifier: Apache-2.0
"""Patterns as tuples of tokens, in a normal form, and what they match.

A :data:`Glob` is normalised: runs of literal characters are one string, sets of one character are literals, and in
a run of ``*`` and ``?`` the ``?`` come first and one ``*`` last. Equal tuples match the same names; so may
different ones.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from functools import cache, lru_cache
from itertools import chain, product
from math import prod

from comarmor.patterns.tokens import ANY, POSIX, SPECIAL, STAR, Bracket, Charset, Dialect, Star, Token, tokenize

Glob = tuple[Token, ...]
EVERYTHING: Glob = (STAR,)


@lru_cache(maxsize=1 << 14)
def parse(expression: str, dialect: Dialect = POSIX) -> Glob:
    """Return the pattern of an expression.

    Raises:
        PatternError: the expression contains undefined notation that is an error in the dialect.
    """
    if not SPECIAL.search(expression):
        return (expression,) if expression else ()
    tokens = tokenize(expression, dialect)
    return normalise(token.charset() if isinstance(token, Bracket) else token for token in tokens)


def normalise(tokens: Iterable[Token]) -> Glob:
    """Return tokens in the normal form; see the module."""
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
    """Return the only name that a pattern matches, or None for a pattern with wildcards."""
    if not glob:
        return ""
    return glob[0] if len(glob) == 1 and isinstance(glob[0], str) else None


def prefix(glob: Glob) -> str:
    """Return the literal text that a pattern begins with."""
    return glob[0] if glob and isinstance(glob[0], str) else ""


def suffix(glob: Glob) -> str:
    """Return the literal text that a pattern ends with."""
    return glob[-1] if glob and isinstance(glob[-1], str) else ""


def is_empty(glob: Glob) -> bool:
    """Return whether a pattern matches no name, as ``[b-a]`` does."""
    return literal(glob) is None and any(isinstance(token, Charset) and not token.ranges for token in glob)


def words(glob: Glob, most: int) -> tuple[str, ...]:
    """Return the names that a pattern matches, or none of them if they are more than a number."""
    choices = [(token,) if isinstance(token, str) else token.chars() for token in glob if not isinstance(token, Star)]
    if len(choices) < len(glob) or prod(len(token) for token in glob if isinstance(token, Charset)) > most:
        return ()
    return tuple(map("".join, product(*choices)))


def filled_text(glob: Glob, star: str, choose: Callable[[Charset], str]) -> str:
    """Return a text like a pattern.

    Args:
        glob: the pattern.
        star: text in place of each ``*``.
        choose: returns a character, or no text, in place of a set.
    """
    return "".join(
        token if isinstance(token, str) else star if isinstance(token, Star) else choose(token) for token in glob
    )


def sort_key(glob: Glob) -> str:
    """Return a text that sorts patterns the same way on every machine; NUL marks tokens that are not literal."""
    if (text := literal(glob)) is not None:
        return text
    return filled_text(glob, "\0*", lambda token: "\0?" if token == ANY else f"\0{token.ranges}")


def surround(head: str, glob: Glob, tail: str) -> Glob:
    """Return the pattern of the names ``head + name + tail``."""
    text = literal(glob)
    if text is not None:
        text = head + text + tail
        return (text,) if text else ()
    return normalise((head, *glob, tail))


@cache
def units(glob: Glob) -> tuple[Token, ...]:
    """Return a pattern with its literal text split into single characters."""
    return tuple(chain.from_iterable(token if isinstance(token, str) else (token,) for token in glob))


def left_quotient(glob: Glob, start: str) -> tuple[Glob, ...]:
    """Return the partial derivatives of a pattern with respect to the start of names.

    Their union matches exactly the names ``n`` for which the pattern matches ``start + n`` (V. Antimirov, "Partial
    derivatives of regular expressions", 1996).
    """
    head = prefix(glob)
    if head.startswith(start):
        return (normalise((head.removeprefix(start), *glob[1:])) if start else glob,)
    if not start.startswith(head):
        return ()
    derivatives = {units(glob)}
    for char in start:
        derivatives = {rest for tokens in derivatives for rest in _derive(tokens, char)}
    return tuple(dict.fromkeys(normalise(tokens) for tokens in sorted(derivatives, key=len)))


@lru_cache(maxsize=1 << 14)
def right_quotient(glob: Glob, end: str) -> tuple[Glob, ...]:
    """Return patterns of the names ``n`` for which a pattern matches ``n + end``: :func:`left_quotient` backwards."""
    if not end:
        return (glob,)
    tail = suffix(glob)
    if tail.endswith(end):
        return (normalise((*glob[:-1], tail.removesuffix(end))),)
    if not end.endswith(tail):
        return ()
    backwards = normalise(reversed(units(glob)))
    return tuple(normalise(reversed(units(left))) for left in left_quotient(backwards, end[::-1]))


def _derive(tokens: tuple[Token, ...], char: str) -> Iterator[tuple[Token, ...]]:
    for index, token in enumerate(tokens):
        if isinstance(token, Star):
            yield tokens[index:]
            continue
        if (token == char) if isinstance(token, str) else (char in token):
            yield tokens[index + 1 :]
        return


Matcher = Callable[[str], bool]


@lru_cache(maxsize=1 << 14)
def matcher(glob: Glob) -> Matcher:  # noqa: PLR0911 - one for each shape
    """Return a function that tells whether a pattern matches a name, in polynomial time."""
    if (text := literal(glob)) is not None:
        return text.__eq__
    match glob:
        case (Star(),):
            return lambda _: True
        case (str(head), Star()):
            return lambda name: name.startswith(head)
        case (Star(), str(tail)):
            return lambda name: name.endswith(tail)
        case (Star(), str(text), Star()):
            return lambda name: text in name
        case (str(head), Star(), str(tail)):
            shortest = len(head) + len(tail)
            return lambda name: len(name) >= shortest and name.startswith(head) and name.endswith(tail)
    expression = re.compile(regex(glob), re.DOTALL)
    return lambda name: expression.fullmatch(name) is not None


def matches(glob: Glob, name: str) -> bool:
    """Return whether a pattern matches a name."""
    return matcher(glob)(name)


def regex(glob: Glob) -> str:
    """Return a regular expression for :func:`re.fullmatch` with :data:`re.DOTALL`, which needs polynomial time.

    Between two ``*`` there is text of a fixed length. Its leftmost match is as good as any other, so that the search
    for it can be an atomic group. Without these groups ``*a*a*a*b`` needs exponential time.
    """
    steps = [""]
    for token in glob:
        if isinstance(token, Star):
            steps.append("")
        elif isinstance(token, str):
            steps[-1] += re.escape(token)
        elif not token.ranges:
            steps[-1] += "(?!)"
        elif token == ANY:
            steps[-1] += "."
        else:
            negated, ranges = token.bracket_ranges()
            members = "".join(rf"\U{low:08x}-\U{high:08x}" for low, high in ranges)
            steps[-1] += f"[{'^' * negated}{members}]"
    if len(steps) == 1:
        return steps[0]
    return steps[0] + "".join(f"(?>.*?{step})" for step in steps[1:-1]) + ".*" + steps[-1]
