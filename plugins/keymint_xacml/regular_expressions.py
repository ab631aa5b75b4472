# SPDX-License-Identifier: Apache-2.0
r"""Expressions of names as regular expressions of XPath 2.0, which the function ``string-regexp-match`` takes.

XACML 3.0, A.3.13 refers to ``xf:matches``: without anchors it looks for a part of the text, and without flags ``.``
matches no line feed. So the expressions here have anchors, and ``[\s\S]`` for any character, which implementations of
other dialects (Java, Python) read alike.
"""

from __future__ import annotations

from comarmor.patterns.glob import literal, parse
from comarmor.patterns.tokens import ANY, COMARMOR, MAX_CODE, Charset, Star, Token
from comarmor.values import dataclass
from keymint.errors import UnsayableError

_XML = Charset(((9, 10), (13, 13), (32, 0xD7FF), (0xE000, 0xFFFD), (0x10000, MAX_CODE)))
"""The characters of XML 1.0 (2.2): a policy and a request have no others."""
_ANY = r"[\s\S]"
_SPECIAL = {ord(char): f"\\{char}" for char in r"\|.-^?*+{}()[]$"} | {9: r"\t", 10: r"\n", 13: r"\r"}
"""Escapes of single characters (XML Schema Part 2, F.1.1; XPath 2.0 Functions, 7.6.1, has the one of ``$``)."""


@dataclass(frozen=True, slots=True)
class TextMatch:
    """How a text is compared.

    Attributes:
        text: the text, or a regular expression with both anchors.
        is_regular: whether it is a regular expression.
    """

    text: str
    is_regular: bool = False


def text_match(expression: str, suffix: str = "") -> TextMatch:
    """Return the comparison that matches the same names, as far as XML can contain them.

    Args:
        expression: an expression of a policy (:data:`comarmor.patterns.tokens.COMARMOR`).
        suffix: follows what it matches.

    Raises:
        UnsayableError: the expression matches no text that XML can contain, or has a character that XML cannot contain.
        PatternError: it is not an expression.
    """
    glob = parse(expression, COMARMOR)
    text = literal(glob)
    if text is None:
        return TextMatch("".join(("^", *map(_token, glob), _token(suffix), "$")), is_regular=True)
    _token(text)
    return TextMatch(text + suffix)


def _token(token: Token) -> str:
    if isinstance(token, Star):
        return f"{_ANY}*"
    if isinstance(token, Charset):
        return _set(token)
    for char in token:
        if char not in _XML:
            raise UnsayableError(f"XML has no character U+{ord(char):04X}")
    return token.translate(_SPECIAL)


def _set(charset: Charset) -> str:
    """Return a set; one that reaches the last character is written by those that are missing."""
    if not charset.intersection(_XML).ranges:
        raise UnsayableError("XML has none of the characters of a set")
    missing = charset.complement().intersection(_XML).ranges
    if charset == ANY or not missing:
        return _ANY
    is_negated = charset.ranges[-1][1] == MAX_CODE
    ranges = missing if is_negated else charset.intersection(_XML).ranges
    members = "".join(_char(low) if low == high else f"{_char(low)}-{_char(high)}" for low, high in ranges)
    return f"[{'^' if is_negated else ''}{members}]"


def _char(code: int) -> str:
    return _SPECIAL.get(code, chr(code))
