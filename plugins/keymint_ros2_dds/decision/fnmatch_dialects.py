# SPDX-License-Identifier: Apache-2.0
"""The dialects of ``fnmatch`` in which implementations read the expressions of a permissions document.

All compare bytes, as the vendors do in the C locale: text is encoded as UTF-8, and each byte is one character. No
expression is an error: see :class:`comarmor.patterns.tokens.Undefined`.
"""

from __future__ import annotations

from functools import lru_cache

from comarmor.patterns.glob import parse, regex
from comarmor.patterns.tokens import SPECIAL, Dialect

STANDARD = Dialect()
"""POSIX ``fnmatch`` with flags 0, as DDS Security 1.1 requires (9.4.1.3.2.3.2.1)."""
FAST_DDS = Dialect(escapes=False)
"""``fnmatch(…, FNM_NOESCAPE)`` of the C library."""
CYCLONE_DDS = Dialect(escapes=False, negators=("!",), classes=False, closing_bracket_is_member=True)
"""Cyclone DDS's own matcher, ``ac_fnmatch``."""


def in_bytes(text: str) -> str:
    """Return a text with one character for each byte of its UTF-8 form."""
    return text if text.isascii() else text.encode("utf-8", "surrogateescape").decode("latin-1")


def is_plain(pattern: str) -> bool:
    """Return whether a pattern matches only itself in every dialect."""
    return not SPECIAL.search(pattern)


@lru_cache(maxsize=65536)
def translate(pattern: str, dialect: Dialect) -> str:
    """Return a pattern (in bytes) as a regular expression; see :func:`comarmor.patterns.glob.regex`."""
    return regex(parse(pattern, dialect))
