# SPDX-License-Identifier: Apache-2.0
"""Test whether a pattern can match a fully qualified ROS name, and advise what to write instead.

See :mod:`comarmor.ros_names` for the form of these names.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import lru_cache

from comarmor.patterns.glob import Glob, parse, units
from comarmor.patterns.tokens import PatternError, Star, Token
from comarmor.ros_names import RAW_PREFIXES

_START, _SLASH, _SEGMENT = range(3)
"""The previous character: none, a ``/``, or one of a segment. A name ends in a segment."""
_DIGITS = "0123456789"
_LETTERS = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz_"


@lru_cache(maxsize=1 << 14)
def matches_ros_name(pattern: Glob) -> bool:
    """Return whether a pattern matches at least one fully qualified ROS name; exact."""
    tokens = units(pattern)
    todo = [(0, _START)]
    seen = set(todo)
    while todo:
        index, previous = todo.pop()
        if index == len(tokens):
            if previous == _SEGMENT:
                return True
            continue
        for state in _following(tokens[index], index, previous):
            if state not in seen:
                seen.add(state)
                todo.append(state)
    return False


def _following(token: Token, index: int, previous: int) -> Iterator[tuple[int, int]]:
    if isinstance(token, Star):
        yield index + 1, previous
    following = index if isinstance(token, Star) else index + 1
    if previous != _SLASH and _has(token, "/"):
        yield following, _SLASH
    if previous != _START and _has(token, _LETTERS if previous == _SLASH else _LETTERS + _DIGITS):
        yield following, _SEGMENT


def _has(token: Token, chars: str) -> bool:
    return isinstance(token, Star) or any(char in token for char in chars)


def advice(expression: str) -> str:
    """Return what to write instead of an expression that matches no ROS name, on one line."""
    plain = expression.removeprefix("/")
    if plain.startswith("~"):
        rest = plain[1:].removeprefix("/")
        return f"'~' is not expanded in a policy: write the node's full name, {{namespace}}{{name}}/{rest}".rstrip("/")
    if prefix := next(filter(expression.startswith, RAW_PREFIXES), ""):
        name = f"/{expression.removeprefix(prefix)}"
        return f"write {name!r}: {prefix!r} is the prefix of the raw topic, which only a rule of kind 'topic' names"
    if any(char in expression for char in "(|)"):
        return "'(', '|' and ')' are literal characters: write an <attachment> for each alternative"
    if ".*" in expression:
        return f"expressions are those of fnmatch, not regular expressions: write {expression.replace('.*', '*')!r}"
    for candidate in (
        f"/{expression}",
        re.sub("/{2,}", "/", expression),
        expression.rstrip("/"),
        expression.replace("-", "_"),
    ):
        if candidate != expression and _can_match(candidate):
            every = ": every ROS name begins with '/'" if candidate == f"/{expression}" else ""
            return f"write {candidate!r}{every}"
    return "segments are letters, digits and '_', do not begin with a digit, and none is empty"


def _can_match(expression: str) -> bool:
    try:
        return matches_ros_name(parse(expression))
    except PatternError:
        return False
