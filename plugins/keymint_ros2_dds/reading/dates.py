"""The dates of a grant's validity (``xs:dateTime``), as implementations read them. None is a date that is none."""

from __future__ import annotations

import re
from datetime import UTC, datetime, timedelta
from functools import lru_cache

_DATE = re.compile(r"(-?\d{4,})-(\d\d)-(\d\d)T(\d\d):(\d\d):(\d\d)(?:\.\d+)?(?:Z|([+-])(\d\d):(\d\d))?", re.ASCII)
_BEGINNING = re.compile(r"\s*(\d{4})-(\d\d)-(\d\d)T(\d\d):(\d\d):(\d\d)", re.ASCII)
_FAST_MAY_READ = re.compile(r"\s*\d{1,4}-\d{1,2}-\d{1,2}", re.ASCII)
_PLAIN = re.compile(r"[12]\d{3}-\d\d-\d\dT\d\d:\d\d:\d\dZ?", re.ASCII)
_LAST_OF_CYCLONE = datetime(2262, 4, 11, 23, 47, 16, tzinfo=UTC)
_BLANKS = " \t\v\r\n"
_FIRST, _LAST = datetime.min.replace(tzinfo=UTC), datetime.max.replace(tzinfo=UTC)
_LAST_HOUR, _LAST_MINUTE, _LEAP_SECOND, _LAST_YEAR = 23, 59, 60, 9999


@lru_cache(maxsize=64)
def standard(text: str) -> datetime | None:
    """A date without a zone is in UTC (DDS Security 1.1, 9.4.1.3.2.2); years beyond the calendar are its ends."""
    found = _DATE.fullmatch(text.strip(_BLANKS))
    if found is None:
        return None
    if not 1 <= (year := int(found[1])) <= _LAST_YEAR:
        return _LAST if year > 0 else _FIRST
    if found[4] == "24":  # midnight at the end of a day
        midnight = _moment(found, hour=0)
        return None if midnight is None else _shifted(midnight, timedelta(days=1))
    return _moment(found, hour=int(found[4]))


@lru_cache(maxsize=64)
def cyclone(text: str) -> datetime | None:
    """As the standard has it; but years have four digits, zones end at 12:00, and time in 2262."""
    found = _DATE.fullmatch(text.strip(_BLANKS))
    if found is None or len(found[1]) != len("2262"):
        return None
    if found[7] and (int(found[8]), int(found[9])) > (12, 0):
        return None
    moment = _moment(found, hour=int(found[4]))
    return None if moment is None or moment > _LAST_OF_CYCLONE else moment


@lru_cache(maxsize=64)
def fast(text: str) -> datetime | None:
    """What follows the seconds is ignored, also the zone; local time is taken to be UTC; 30 February is 2 March."""
    found = _BEGINNING.match(text)
    if found is None:
        return None
    year, month, day, hour, minute, second = map(int, found.groups())
    if not (1 <= month <= 12 and 1 <= day <= 31):  # noqa: PLR2004 - months and days
        return None
    if hour > _LAST_HOUR or minute > _LAST_MINUTE or second > _LEAP_SECOND:
        return None
    first = datetime(max(year, 1), month, 1, tzinfo=UTC)
    return _shifted(first, timedelta(days=day - 1, hours=hour, minutes=minute, seconds=second))


def fast_may_read(text: str) -> bool:
    """Tell whether Fast DDS may read a text that is no date for :func:`fast`; that is known of some forms only."""
    return _BEGINNING.match(text) is None and _FAST_MAY_READ.match(text) is not None


def is_plain(text: str) -> bool:
    """Tell whether a text is a date in the usual form, which the schema allows."""
    return _PLAIN.fullmatch(text) is not None and standard(text) is not None


def _moment(found: re.Match[str], *, hour: int) -> datetime | None:
    try:
        year, month, day, minute, second = (int(found[index]) for index in (1, 2, 3, 5, 6))
        moment = datetime(year, month, day, hour, minute, second, tzinfo=UTC)
    except ValueError:
        return None
    if not found[7]:
        return moment
    if int(found[9]) > _LAST_MINUTE:
        return None
    offset = timedelta(hours=int(found[8]), minutes=int(found[9]))
    return _shifted(moment, -offset if found[7] == "+" else offset)


def _shifted(moment: datetime, by: timedelta) -> datetime:
    try:
        return moment + by
    except OverflowError:
        return _LAST if by > timedelta() else _FIRST
