# SPDX-License-Identifier: Apache-2.0
"""Periods of validity: two dates, or a date and an ISO 8601 duration."""

from __future__ import annotations

from datetime import UTC, datetime

from lxml import etree

from comarmor.text import quote
from comarmor.values import replace
from keymint.api import Validity
from keymint.api.source_documents import place, text
from keymint.errors import KeymintError, Origin
from keymint.pki import periods

_YEARS = range(1950, 10000)
"""RFC 5280, 4.1.2.5: the years that UTCTime and GeneralizedTime of a certificate can express."""
_LAST = datetime(9999, 12, 31, 23, 59, 59, tzinfo=UTC)
_LONGEST = 64
"""Most characters of a date or a duration."""


def read(element: etree._Element | None) -> Validity | None:
    """Return the period of a ``<validity>`` element, or None if there is no element.

    Raises:
        KeymintError: a date does not exist, or the end is not after the start.
    """
    if element is None:
        return None
    start, end = element
    not_before = date(start)
    not_after = date(end) if end.tag == "not_after" else _sum(not_before, text(end) or "", place(end))
    if not_after <= not_before:
        message = (
            f"the validity ends at {not_after:%Y-%m-%dT%H:%M:%SZ}, which is not after its start at "
            f"{not_before:%Y-%m-%dT%H:%M:%SZ}"
        )
        raise KeymintError(message, where=place(end), help="give an end after the start", code="validity-order")
    return Validity(not_before, not_after, place(end))


def renewed_period(period: Validity, start: datetime | None) -> Validity:
    """Return a period that begins at a later date, and is as long as before; itself if the date is not later.

    It ends with the year 9999 at the latest, which stands for no end (RFC 5280, 4.1.2.5).
    """
    if start is None or start <= period.not_before:
        return period
    try:
        end = start + (period.not_after - period.not_before)
    except OverflowError:
        end = _LAST
    return replace(period, not_before=start, not_after=min(end, _LAST))


def begin_of_period(duration: str, now: datetime) -> str:
    """Return the begin, as text, of a period of this length that is given now.

    Args:
        duration: the length, an ISO 8601 duration.
        now: the clock, UTC.

    Raises:
        KeymintError: not a duration, or one that ends before it begins or after the year 9999.
    """
    return date_text(periods.begin(now, _sum(now, duration) - now))


def date_text(moment: datetime) -> str:
    """Return a date as documents have it: in UTC, without a zone."""
    return f"{moment.astimezone(UTC):%Y-%m-%dT%H:%M:%S}"


def element(period: Validity) -> str:
    """Return the element of a period, as :func:`read` reads it."""
    begin, end = date_text(period.not_before), date_text(period.not_after)
    return f"<validity><not_before>{begin}</not_before><not_after>{end}</not_after></validity>"


def length(root: etree._Element) -> str:
    """Return the length of the ``<validity>`` of a document as an ISO 8601 duration; empty if it has none.

    It is the text of ``<duration>``, or else the whole days between the dates.
    """
    element = root.find(".//validity")
    period = read(element)
    if element is None or period is None:
        return ""
    return text(element.find("duration")) or f"P{(period.not_after - period.not_before).days}D"


def date(element: etree._Element) -> datetime:
    """Return the date of an element; without a zone it is in UTC.

    Raises:
        KeymintError: no such date, or a year that a certificate cannot express.
    """
    content = text(element) or ""
    try:
        found = datetime.fromisoformat(content) if len(content) <= _LONGEST else None
        found = found and (found.replace(tzinfo=UTC) if found.tzinfo is None else found.astimezone(UTC))
    except (ValueError, OverflowError):
        found = None
    if found is None or found.year not in _YEARS:
        message = f"{quote(content, _LONGEST)} is not a date between the years {_YEARS.start} and {_YEARS[-1]}"
        help_ = "write e.g. 2026-01-31T00:00:00, which means UTC, or with a zone 2026-01-31T00:00:00+01:00"
        raise KeymintError(message, where=place(element), help=help_, code="date-invalid")
    return found.replace(microsecond=0)


def _sum(start: datetime, content: str, where: Origin | None = None) -> datetime:
    """Return the date that is a duration after ``start``."""
    import isodate  # type: ignore[import-untyped] # noqa: PLC0415 - most documents have two dates

    end: datetime | None = None
    message, help_ = f"{quote(content, _LONGEST)} is not an ISO 8601 duration", "write e.g. P1Y, P90D or PT12H"
    try:
        duration = isodate.parse_duration(content[:_LONGEST])
        message = f"the duration {content!r} from {start:%Y-%m-%d} must end later, and before the year {_YEARS.stop}"
        help_ = "write a positive duration, e.g. P1Y"
        end = start + duration
    except (ValueError, ArithmeticError):
        pass  # the message says what failed
    if end is None or end.year not in _YEARS or end < start:
        raise KeymintError(message, where=where, help=help_, code="duration-invalid")
    return end.replace(microsecond=0)
