# SPDX-License-Identifier: Apache-2.0
"""Where periods of validity begin."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

from hypothesis import given, strategies as st

from keymint.pki.periods import begin

MOMENTS = st.datetimes(datetime(1970, 1, 3), datetime(9000, 1, 1), timezones=st.just(UTC))  # noqa: DTZ001
LENGTHS = st.timedeltas(timedelta(hours=1), timedelta(days=73_000))


@given(MOMENTS, LENGTHS)
def test_most_of_a_period_lies_ahead_and_a_little_behind(now: datetime, length: timedelta) -> None:
    first = begin(now, length)
    assert now - first >= min(timedelta(days=1), length / 10)
    assert now - first < max(timedelta(days=2), timedelta(minutes=1))
    assert (first + length - now) / length >= 0.8
    assert (first.second, first.microsecond) == (0, 0)


@given(MOMENTS, MOMENTS, LENGTHS)
def test_it_never_goes_back(one: datetime, other: datetime, length: timedelta) -> None:
    early, late = sorted((one, other))
    assert begin(early, length) <= begin(late, length)


def test_a_day_has_one_begin() -> None:
    morning = datetime(2027, 3, 4, 0, 0, 1, tzinfo=UTC)
    assert begin(morning, timedelta(days=90)) == begin(morning + timedelta(hours=23), timedelta(days=90))
    assert begin(morning, timedelta(days=90)) == datetime(2027, 3, 3, tzinfo=UTC)
