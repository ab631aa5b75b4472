# SPDX-License-Identifier: Apache-2.0
"""Test whether a pattern can match a fully qualified ROS name, and advise what to write instead.

See :mod:`comarmor.rules` for the form of these names.
"""

from __future__ import annotations

import re
from contextlib import suppress
from functools import lru_cache

from comarmor.patterns.glob import Glob, parse
from comarmor.patterns.tokens import PatternError, Star
from comarmor.rules import RAW_PREFIXES, is_fully_qualified

_START, _SLASH, _SEGMENT = 1, 2, 4
"""The previous character: none, a ``/``, or one of a segment; as bits, for a set of these. A name ends in a segment."""
_DIGITS = "0123456789"
_LETTERS = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz_"
_SLASH_AFTER, _LETTER_AFTER, _DIGIT_AFTER = _START | _SEGMENT, _SLASH | _SEGMENT, _SEGMENT
"""After which characters a ``/``, a letter and a digit may follow."""


@lru_cache(maxsize=1 << 14)
def matches_ros_name(pattern: Glob) -> bool:
    """Return whether a pattern matches at least one fully qualified ROS name; exact."""
    previous = _START
    for token in pattern:
        if isinstance(token, Star):
            previous |= _SLASH | _SEGMENT if previous else 0  # every name so far can go on to both
        elif isinstance(token, str):
            previous = _after_text(previous, token)
        else:
            previous = _after(previous, *(any(char in token for char in chars) for chars in ("/", _LETTERS, _DIGITS)))
    return bool(previous & _SEGMENT)


def _after_text(previous: int, text: str) -> int:
    if previous == _START and is_fully_qualified(text.removesuffix("/")):
        return _SLASH if text.endswith("/") else _SEGMENT
    for char in text:
        previous = _after(previous, char == "/", char in _LETTERS, char in _DIGITS)
    return previous


def _after(previous: int, slash: bool, letter: bool, digit: bool) -> int:
    """Return what a character of a token may be, after these previous ones: no bit if none can follow."""
    segment = (letter and previous & _LETTER_AFTER) or (digit and previous & _DIGIT_AFTER)
    return (_SLASH if slash and previous & _SLASH_AFTER else 0) | (_SEGMENT if segment else 0)


def advice(expression: str) -> str:
    """Return what to write instead of an expression that matches no ROS name, on one line."""
    plain = expression.removeprefix("/")
    if plain.startswith("~"):
        rest = plain[1:].removeprefix("/")
        return f"'~' is not expanded in a policy: write the node's full name, {{namespace}}{{name}}/{rest}".rstrip("/")
    if prefix := next(filter(expression.startswith, RAW_PREFIXES), ""):
        name = f"/{expression.removeprefix(prefix)}"
        return f"write {name!r}: {prefix!r} is the prefix of the raw topic, which only a rule of kind 'topic' names"
    slips = {
        "'(', '|' and ')' are literal characters: write an <attachment> for each alternative": r"[(|)]",
        "write an <attachment> for each name, all in one <attachments>": r"[, ]",
        "expressions are those of fnmatch, which match whole names: leave out '^' and '$'": r"^\^|\$$",
    }
    if slip := next((text for text, pattern in slips.items() if re.search(pattern, expression)), ""):
        return slip
    if ".*" in expression:
        return f"expressions are those of fnmatch, not regular expressions: write {expression.replace('.*', '*')!r}"
    for candidate in (
        f"/{expression}",
        re.sub("/{2,}", "/", expression),
        expression.rstrip("/"),
        expression.replace("-", "_"),
    ):
        with suppress(PatternError):
            if candidate != expression and matches_ros_name(parse(candidate)):
                every = ": every ROS name begins with '/'" if candidate == f"/{expression}" else ""
                return f"write {candidate!r}{every}"
    return "segments are letters, digits and '_', do not begin with a digit, and none is empty"
