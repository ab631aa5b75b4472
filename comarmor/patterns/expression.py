# SPDX-License-Identifier: Apache-2.0
r"""Attachment expressions of policies: the dialect :data:`comarmor.patterns.tokens.COMARMOR` of ``fnmatch``."""

from __future__ import annotations

from functools import lru_cache

from comarmor.patterns.glob import normalise
from comarmor.patterns.matching import Matcher, matcher
from comarmor.patterns.tokens import COMARMOR, SPECIAL, Bracket, Token, tokenize


@lru_cache(maxsize=65536)
def parse(expression: str) -> tuple[Token | Bracket, ...]:
    """Return the tokens of an expression.

    Raises:
        PatternError: the expression contains notation that POSIX leaves undefined.
    """
    return tuple(tokenize(expression, COMARMOR))


def matches(expression: str, name: str) -> bool:
    """Return whether an expression matches a name.

    Raises:
        PatternError: as of :func:`parse`.
    """
    return _matcher(expression)(name)


@lru_cache(maxsize=65536)
def _matcher(expression: str) -> Matcher:
    return matcher(normalise(token.charset() if isinstance(token, Bracket) else token for token in parse(expression)))


@lru_cache(maxsize=65536)
def literal(expression: str) -> str | None:
    """Return the only name that an expression without wildcards matches, or None for one with wildcards.

    Raises:
        PatternError: as of :func:`parse`.
    """
    if not SPECIAL.search(expression):
        return expression
    tokens = parse(expression)
    texts = [token for token in tokens if isinstance(token, str)]
    return "".join(texts) if len(texts) == len(tokens) else None


def literal_prefix(expression: str) -> str:
    """Return the text before the first special character: every name that the expression matches begins with it."""
    special = SPECIAL.search(expression)
    return expression[: special.start()] if special else expression
