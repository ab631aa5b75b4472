"""Text from anywhere (names on disk, policies, other programs) as text that is safe to show and to hand on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from typing import Any


def printable(text: str) -> str:
    """Return text on one line, with all that is not printable escaped as Python does.

    That covers what steers a terminal (C0 and C1 controls), what reorders or hides text (format characters, such as
    the overrides of Unicode's bidirectional algorithm), line ends, and bytes of a file's name that are no UTF-8
    (lone surrogates, PEP 383).
    """
    if text.isprintable():
        return text
    return "".join(char if char.isprintable() else _escaped(char) for char in text)


def printable_lines(text: str) -> str:
    """Return text of several lines (or with tabs), escaped as :func:`printable` does but for these."""
    if text.isascii() and text.isprintable():
        return text
    return "".join(char if char.isprintable() or char in "\n\t" else _escaped(char) for char in text)


def encodable(value: Any) -> Any:
    """Return what JSON can hold, with lone surrogates in its texts escaped: they have no form in UTF-8 (RFC 8259, 8.1).

    Args:
        value: texts, numbers, and mappings and sequences of them.
    """
    if isinstance(value, str):
        return value if value.isascii() else value.encode("utf-8", "backslashreplace").decode()
    if isinstance(value, Mapping):
        return {encodable(key): encodable(item) for key, item in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, bytes | bytearray):
        return [encodable(item) for item in value]
    return value


def did_you_mean(word: str, known: Sequence[str]) -> str:
    """Return ``did you mean …?`` with the nearest known word, or an empty string when none is near."""
    near = get_close_matches(word[:64], known, n=1)
    return f"did you mean {near[0]}?" if near else ""


def quoted(text: str, limit: int = 60) -> str:
    """Return text on one line, in quotes, cut to a length at which a message can still be read."""
    shown = "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text[: limit + 1])
    return f"'{shown[:limit]}…'" if len(shown) > limit else f"'{shown}'"


def _escaped(char: str) -> str:
    return char.encode("unicode_escape").decode()
