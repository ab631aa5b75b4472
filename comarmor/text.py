# SPDX-License-Identifier: Apache-2.0
"""Text for messages: escaped, quoted, counted, with the nearest known word, and safe for JSON; regular expressions."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterable, Mapping, Sequence
from datetime import datetime
from typing import Any, AnyStr, cast


def lazy_regex(pattern: AnyStr, flags: int = 0) -> re.Pattern[AnyStr]:
    """Return a regular expression like :func:`re.compile`, which is compiled when a method of it is first used.

    A run uses few of those that its modules define.

    Errors in the pattern are raised then; so use it for patterns that are part of the program only.

    Args:
        pattern: the regular expression.
        flags: of :mod:`re`.
    """
    return cast("re.Pattern[AnyStr]", _Regex(pattern, flags))


class _Regex:
    """Has the attributes of a compiled regular expression; each is kept when it is first used."""

    def __init__(self, pattern: Any, flags: int) -> None:
        self._source = (pattern, flags)

    def __reduce__(self) -> tuple[Any, ...]:
        return _Regex, self._source

    def __getattr__(self, name: str) -> Any:
        value = getattr(re.compile(*self._source), name)
        setattr(self, name, value)
        return value


_NUMBER = lazy_regex("([0-9]+)")
_LONGEST_WORD = 128
"""Characters of a word that are compared, and shown, at most: difflib takes quadratic time."""


def one_line(text: str) -> str:
    """Return text on one line, with characters that are not printable escaped as in Python.

    These are terminal controls (C0 and C1), characters that reorder or hide text (format characters, such as the
    overrides of Unicode's bidirectional algorithm), line ends, and bytes of file names that are not UTF-8 (lone
    surrogates, PEP 383).
    """
    if text.isprintable():
        return text
    return "".join(char if char.isprintable() else _escaped(char) for char in text)


def printable_lines(text: str) -> str:
    """Return text escaped as by :func:`one_line`, but with line ends and tabs kept."""
    if text.isascii() and text.isprintable():
        return text
    return "".join(char if char.isprintable() or char in "\n\t" else _escaped(char) for char in text)


def encodable_value(value: Any) -> Any:
    """Return a value for JSON, with lone surrogates in texts escaped, which UTF-8 cannot encode (RFC 8259, 8.1).

    Args:
        value: texts, numbers, moments (in ISO 8601), and mappings and sequences of them.
    """
    if isinstance(value, str):
        return value if value.isascii() else value.encode("utf-8", "backslashreplace").decode()
    if isinstance(value, Mapping):
        return {encodable_value(key): encodable_value(item) for key, item in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, bytes | bytearray):
        return [encodable_value(item) for item in value]
    return value.isoformat() if isinstance(value, datetime) else value


def nearest_word(word: str, known: Iterable[str], similarity: float = 0.6) -> str:
    """Return the known word that is most similar to a word, whatever its case; empty if none is similar enough.

    Args:
        word: what somebody wrote.
        known: what they may have meant.
        similarity: the least that counts, from 0 to 1 (:meth:`difflib.SequenceMatcher.ratio`).
    """
    from difflib import get_close_matches  # noqa: PLC0415 - only messages of errors need it

    by_lower_case = {each.lower(): each for each in known}
    matches = get_close_matches(word[:_LONGEST_WORD].lower(), by_lower_case, n=1, cutoff=similarity)
    return by_lower_case[matches[0]] if matches else ""


def did_you_mean(word: str, known: Iterable[str], otherwise: str = "", *, similarity: float = 0.6) -> str:
    """Return ``did you mean '…'?`` with the nearest known word, or another hint if no word is near."""
    near = nearest_word(word, known, similarity)
    return f"did you mean {quote(near, _LONGEST_WORD)}?" if near else otherwise


def quote(text: str, limit: int = 60) -> str:
    """Return text in quotes on one line, escaped, and cut to a length that keeps a message readable."""
    shown = one_line(text[: limit + 1])
    return f"'{shown[:limit]}…'" if len(shown) > limit else f"'{shown}'"


def hexadecimal(number: int) -> str:
    """Return a serial number as openssl does, in whole bytes: ``0a1b``."""
    digits = f"{number:x}"
    return digits.zfill(len(digits) + len(digits) % 2)


def quantity(number: int, noun: str) -> str:
    """Return a number with its noun: ``no edges``, ``1 edge``, ``2 mismatches``."""
    ending = "" if number == 1 else "es" if noun.endswith(("ch", "x")) else "s"
    return f"{number or 'no'} {noun}{ending}"


def first_few(items: Sequence[str], most: int = 5) -> str:
    """Return the first items separated by commas, with ``…`` for the rest."""
    return ", ".join(items[:most]) + (", …" if len(items) > most else "")


def natural_order(name: str) -> tuple[object, ...]:
    """Return the key that sorts names for people: by the numbers in them, ``r2`` before ``r10``."""
    parts = _NUMBER.split(name)  # text and digits in turn
    numbers = ((len(digits), digits) for digits in (each.lstrip("0") for each in parts[1::2]))
    return (*itertools.chain.from_iterable(itertools.zip_longest(parts[::2], numbers, fillvalue=(0, ""))), name)


def _escaped(char: str) -> str:
    return char.encode("unicode_escape").decode()
