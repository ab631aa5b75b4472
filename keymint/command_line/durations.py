# SPDX-License-Identifier: Apache-2.0
"""Lengths of time on the command line: ``12h``, ``30d``, ``4w``, ``2y``, and ISO 8601 durations."""

from __future__ import annotations

import re
from datetime import timedelta

import click

from comarmor.regex import lazy_regex
from keymint.life.terms import Threshold

_UNITS = {"h": timedelta(hours=1), "d": timedelta(days=1), "w": timedelta(weeks=1), "y": timedelta(days=365)}
_ISO = lazy_regex(
    r"P(?=.)(?:(?P<y>[0-9]{1,4})Y)?(?:(?P<m>[0-9]{1,4})M)?(?:(?P<w>[0-9]{1,5})W)?(?:(?P<d>[0-9]{1,6})D)?(?:T(?:(?P<h>[0-9]{1,6})H))?"
)
_MONTH = timedelta(days=30)
_SHORTEST = timedelta(hours=1)
LONGEST = timedelta(days=365 * 200)
"""Longer than any validity."""
_EXAMPLES = "write 12h, 30d, 4w or 2y"


def period(value: str) -> timedelta:
    """Return a length of time for an option, e.g. ``30d``; a year has 365 days.

    Raises:
        click.BadParameter: it is none, or longer than any validity.
    """
    if match := re.fullmatch(r"([0-9]{1,6})([hdwy])", value):
        length = int(match[1]) * _UNITS[match[2]]
    elif match := _ISO.fullmatch(value):
        given = {unit: int(number) for unit, number in match.groupdict().items() if number}
        length = sum((number * _UNITS.get(unit, _MONTH) for unit, number in given.items()), timedelta())
    else:
        raise click.BadParameter(f"{value!r} is not a length of time; {_EXAMPLES}")
    if length > LONGEST:
        raise click.BadParameter(f"{value!r} is longer than any validity")
    return length


def validity(value: str) -> timedelta:
    """Return a length of validity for an option.

    Raises:
        click.BadParameter: it is no length of time, or not between an hour and 200 years.
    """
    length = period(value)
    if length < _SHORTEST:
        raise click.BadParameter(f"{value!r} is shorter than an hour")
    return length


def iso_validity(value: str) -> str:
    """Return a length of validity for an option as an ISO 8601 duration: ``P90D`` for ``90d``; errors as above."""
    validity(value)
    if value.startswith("P"):
        return value
    number, unit = int(value[:-1]), value[-1].upper()
    return f"PT{number}H" if unit == "H" else f"P{number}{unit}"


def threshold(value: str) -> Threshold:
    """Return when something is due for renewal: ``66%`` of its validity, or the time that is left, e.g. ``30d``.

    Raises:
        click.BadParameter: it is neither, or not a share between 1 % and 99 %.
    """
    if match := re.fullmatch(r"([1-9][0-9]?)%", value):
        return Threshold(share=int(match[1]) / 100)
    if value.endswith("%"):
        raise click.BadParameter(f"{value!r} is not a share from 1% to 99%")
    return Threshold(left=period(value))
