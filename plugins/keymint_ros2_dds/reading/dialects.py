# SPDX-License-Identifier: Apache-2.0
"""How implementations read the expressions of a document, and its dates.

Expressions are read in a dialect of ``fnmatch``. All dialects compare bytes, as the vendors do in the C locale: text is
encoded as UTF-8, and each byte is one character. No expression is an error: see
:class:`comarmor.patterns.tokens.Undefined`.

The dates of a grant's validity are ``xs:dateTime``; one that is invalid is read as None.
"""

from __future__ import annotations

import re
from datetime import UTC, datetime, timedelta
from functools import lru_cache

from comarmor.patterns.glob import parse, regex
from comarmor.patterns.tokens import SPECIAL, Dialect
from comarmor.regex import lazy_regex

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


_DATE = lazy_regex(r"(-?\d{4,})-(\d\d)-(\d\d)T(\d\d):(\d\d):(\d\d)(?:\.\d+)?(?:Z|([+-])(\d\d):(\d\d))?", re.ASCII)
_TO_THE_SECOND = lazy_regex(r"\s*(\d{4})-(\d\d)-(\d\d)T(\d\d):(\d\d):(\d\d)", re.ASCII)
_LAST_OF_CYCLONE = datetime(2262, 4, 11, 23, 47, 16, tzinfo=UTC)
_BLANKS = " \t\v\r\n"
_FIRST, _LAST = datetime.min.replace(tzinfo=UTC), datetime.max.replace(tzinfo=UTC)
_LAST_MINUTE, _LAST_YEAR = 59, 9999


@lru_cache(maxsize=64)
def standard_date(text: str) -> datetime | None:
    """Read a date as the standard says (DDS Security 1.1, 9.4.1.3.2.2): without a zone it is UTC.

    A year beyond the range of :class:`datetime` is the end of that range.
    """
    match = _DATE.fullmatch(text.strip(_BLANKS))
    if match is None:
        return None
    if not 1 <= (year := int(match[1])) <= _LAST_YEAR:
        return _LAST if year > 0 else _FIRST
    if match[4] == "24":  # midnight at the end of a day
        midnight = _moment(match, hour=0)
        return None if midnight is None else _shifted(midnight, timedelta(days=1))
    return _moment(match, hour=int(match[4]))


@lru_cache(maxsize=64)
def cyclone_date(text: str) -> datetime | None:
    """Read a date as Cyclone DDS: years have four digits, zones end at 12:00, and time ends in 2262."""
    match = _DATE.fullmatch(text.strip(_BLANKS))
    if match is None or len(match[1]) != len("2262"):
        return None
    if match[7] and (int(match[8]), int(match[9])) > (12, 0):
        return None
    moment = _moment(match, hour=int(match[4]))
    return None if moment is None or moment > _LAST_OF_CYCLONE else moment


@lru_cache(maxsize=64)
def fast_date(text: str) -> datetime | None:
    """Read a date as Fast DDS: everything after the seconds is ignored, and local time is assumed to be UTC."""
    match = _TO_THE_SECOND.match(text)
    return None if match is None else _clock(match, hour=int(match[4]))


def _clock(match: re.Match[str], *, hour: int) -> datetime | None:
    """Return the date and time of a match, without its zone."""
    try:
        year, month, day, minute, second = (int(match[index]) for index in (1, 2, 3, 5, 6))
        return datetime(year, month, day, hour, minute, second, tzinfo=UTC)
    except ValueError:
        return None


def _moment(match: re.Match[str], *, hour: int) -> datetime | None:
    moment = _clock(match, hour=hour)
    if moment is None or not match[7]:
        return moment
    if int(match[9]) > _LAST_MINUTE:
        return None
    offset = timedelta(hours=int(match[8]), minutes=int(match[9]))
    return _shifted(moment, -offset if match[7] == "+" else offset)


def _shifted(moment: datetime, by: timedelta) -> datetime:
    try:
        return moment + by
    except OverflowError:
        return _LAST if by > timedelta() else _FIRST
