"""The dates of a grant's validity (``xs:dateTime``), as implementations read them. None is a date that never holds."""

from __future__ import annotations

import re
from datetime import UTC, datetime, timedelta

_DATE = re.compile(r"\s*(\d{4,})-(\d\d)-(\d\d)T(\d\d):(\d\d):(\d\d)(?:\.\d+)?(Z|[+-]\d\d:\d\d)?\s*", re.ASCII)
_LAST_OF_CYCLONE = datetime(2262, 4, 11, tzinfo=UTC)


def standard(text: str) -> datetime | None:
    """A date without a zone is in UTC (DDS Security 1.1, 9.4.1.3.2.2)."""
    return _read(text, zone_counts=True)


def cyclone(text: str) -> datetime | None:
    """As the standard has it, but what does not fit nanoseconds since 1970 in 64 bits never holds."""
    found = _read(text, zone_counts=True)
    return None if found is None or found >= _LAST_OF_CYCLONE else found


def fast(text: str) -> datetime | None:
    """The zone is ignored; the host's local time is taken to be UTC, in which Fast DDS is run here."""
    return _read(text, zone_counts=False)


def _read(text: str, *, zone_counts: bool) -> datetime | None:
    found = _DATE.fullmatch(text)
    if found is None:
        return None
    zone = found[7] if zone_counts else None
    try:
        moment = datetime(*(int(found[index]) for index in range(1, 7)), tzinfo=UTC)  # type: ignore[misc,arg-type]
        if zone in {None, "Z"}:
            return moment
        offset = timedelta(hours=int(zone[1:3]), minutes=int(zone[4:6]))
        return moment - offset if zone[0] == "+" else moment + offset
    except (ValueError, OverflowError):
        return None
