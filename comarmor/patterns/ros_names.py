"""Which patterns a fully qualified ROS name can match, and what to write in the place of one that none can.

A fully qualified ROS name is made of segments of letters, digits and ``_`` that do not begin with a digit, each after a
``/`` (ROS 2 design, "Topic and Service name mapping to DDS").
"""

from __future__ import annotations

import re
from collections.abc import Iterator

from comarmor.patterns.glob import Glob, parse, units
from comarmor.patterns.tokens import Charset, PatternError, Star

_START, _SLASH, _SEGMENT = range(3)
"""What stands before: nothing, a ``/``, or a character of a segment. A name ends in a segment."""
_DIGITS = "0123456789"
_LETTERS = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz_"
_DDS_PREFIX = re.compile(r"/?(rt|rq|rr|rs|ra)/")


def is_possible(pattern: Glob) -> bool:
    """Tell whether there is a fully qualified ROS name that a pattern matches; exact."""
    tokens = units(pattern)
    todo = [(0, _START)]
    seen = set(todo)
    while todo:
        at, before = todo.pop()
        if at == len(tokens):
            if before == _SEGMENT:
                return True
            continue
        for state in _following(tokens[at], at, before):
            if state not in seen:
                seen.add(state)
                todo.append(state)
    return False


def _following(token: str | Charset | Star, at: int, before: int) -> Iterator[tuple[int, int]]:
    if isinstance(token, Star):
        yield at + 1, before
    after = at if isinstance(token, Star) else at + 1
    if before != _SLASH and _has(token, "/"):
        yield after, _SLASH
    if before != _START and _has(token, _LETTERS if before == _SLASH else _LETTERS + _DIGITS):
        yield after, _SEGMENT


def _has(token: str | Charset | Star, chars: str) -> bool:
    return isinstance(token, Star) or any(char in token for char in chars)


def advice(expression: str) -> str:
    """Return what to write in the place of an expression that no ROS name can match, in one line."""
    plain = expression.removeprefix("/")
    if plain.startswith("~"):
        rest = plain[1:].removeprefix("/")
        return f"'~' is not expanded in a policy: write the node's full name, {{namespace}}{{name}}/{rest}".rstrip("/")
    if (found := _DDS_PREFIX.match(expression)) and not expression.startswith("/"):
        name, prefix = "/" + expression[found.end() :], f"{found[1]}/"
        return f"write {name!r}: {prefix!r} is the prefix of the DDS topic, which only a rule of kind 'topic' names"
    if any(char in expression for char in "(|)"):
        return "'(', '|' and ')' stand for themselves: write an <attachment> for each alternative"
    if ".*" in expression:
        return f"expressions are those of fnmatch, not regular expressions: write {expression.replace('.*', '*')!r}"
    for mended in (
        f"/{expression}",
        re.sub("/{2,}", "/", expression),
        expression.rstrip("/"),
        expression.replace("-", "_"),
    ):
        if mended != expression and _can_be(mended):
            every = ": every ROS name begins with '/'" if mended == f"/{expression}" else ""
            return f"write {mended!r}{every}"
    return "segments are letters, digits and '_', do not begin with a digit, and none is empty"


def _can_be(expression: str) -> bool:
    try:
        return is_possible(parse(expression))
    except PatternError:
        return False
