# SPDX-License-Identifier: Apache-2.0
"""The dates of a validity period, as each implementation reads them."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta, timezone

import pytest
from hypothesis import given, strategies as st
from keymint_ros2_dds.reading import dialects


@pytest.mark.parametrize(
    ("text", "standard", "cyclone", "fast"),
    [
        ("2030-01-01T00:00:00", "2030-01-01T00", "2030-01-01T00", "2030-01-01T00"),
        ("2030-01-01T00:00:00+02:00", "2029-12-31T22", "2029-12-31T22", "2030-01-01T00"),
        ("2030-01-01T00:00:00+13:00", "2029-12-31T11", None, "2030-01-01T00"),
        ("2030-01-01T24:00:00", "2030-01-02T00", None, None),
        ("2030-02-30T00:00:00", None, None, None),
        ("2262-04-11T23:47:17", "2262-04-11T23", None, "2262-04-11T23"),
        ("2262-04-11T23:47:16.9", "2262-04-11T23", "2262-04-11T23", "2262-04-11T23"),
        ("12030-01-01T00:00:00", "9999-12-31T23", None, None),
        ("2030-01-01T00:00:00 and so on", None, None, "2030-01-01T00"),
        ("2030-01-01", None, None, None),
    ],
)
def test_dates(text: str, standard: str | None, cyclone: str | None, fast: str | None) -> None:
    found = [each(text) for each in (dialects.standard_date, dialects.cyclone_date, dialects.fast_date)]
    assert [each and f"{each:%Y-%m-%dT%H}" for each in found] == [standard, cyclone, fast]


MOMENTS = st.datetimes(datetime(1, 1, 3), datetime(2261, 12, 28)).map(lambda each: each.replace(microsecond=0))  # noqa: DTZ001 - the zone follows


@given(MOMENTS, st.integers(-14 * 60, 14 * 60))
def test_a_zone_moves_a_date_except_on_fast_dds(local: datetime, minutes: int) -> None:
    moment = local.replace(tzinfo=timezone(timedelta(minutes=minutes)))
    text = moment.isoformat()
    assert dialects.standard_date(text) == moment
    assert dialects.cyclone_date(text) == (moment if abs(minutes) <= 12 * 60 else None)
    assert dialects.fast_date(text) == local.replace(tzinfo=UTC)


@given(MOMENTS)
def test_without_a_zone_and_with_a_z_it_is_utc(local: datetime) -> None:
    for text in (local.isoformat(), f" {local.isoformat()}Z\n", f"{local.isoformat()}.123"):
        assert {each(text) for each in (dialects.standard_date, dialects.cyclone_date, dialects.fast_date)} == {
            local.replace(tzinfo=UTC)
        }


def test_beyond_the_calendar_is_its_end() -> None:
    first, last = datetime.min.replace(tzinfo=UTC), datetime.max.replace(tzinfo=UTC)
    assert dialects.standard_date("9999-12-31T23:59:59-01:00") == last
    assert dialects.standard_date("0001-01-01T00:00:00+01:00") == first
    assert dialects.standard_date("-0044-03-15T12:00:00") == first
