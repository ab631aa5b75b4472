# SPDX-License-Identifier: Apache-2.0
"""Where periods of validity begin: somewhat in the past, because the clocks of robots may be slow.

No middleware that was measured allows for clocks that differ, and one reads dates of permissions in local time.
"""

from __future__ import annotations

from datetime import datetime, timedelta

BACK = timedelta(days=1)
"""How long before now a period begins."""
_SHORT = timedelta(days=10)
"""A shorter period begins a tenth of its length before now, so that most of it lies ahead."""


def begin(now: datetime, length: timedelta = _SHORT) -> datetime:
    """Return the begin of a period of validity that is given now.

    Args:
        now: the clock, UTC.
        length: from begin to end; by default one that is not short.

    Returns:
        The first moment of the day before, so that all that is given on one day has the same dates; for a period of
        less than ten days, a tenth of its length before now, in whole minutes.
    """
    if length < _SHORT:
        return (now - back(length)).replace(second=0, microsecond=0)
    return now.replace(hour=0, minute=0, second=0, microsecond=0) - BACK


def back(length: timedelta) -> timedelta:
    """Return how long before now a period begins that is given now and has this length, see :data:`BACK`."""
    return length / 10 if length < _SHORT else BACK
