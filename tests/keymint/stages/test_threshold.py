# SPDX-License-Identifier: Apache-2.0
"""When a document is due for renewal."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

from hypothesis import given, strategies as st

from keymint.life.terms import DEFAULT, Threshold

FIRST = datetime(2027, 1, 1, tzinfo=UTC)
DAY = timedelta(days=1)


def test_two_thirds_of_the_validity_by_default() -> None:
    assert DEFAULT.moment(FIRST, FIRST + 100 * DAY) == FIRST + 66 * DAY


def test_some_time_before_the_end() -> None:
    assert Threshold(left=30 * DAY).moment(FIRST, FIRST + 100 * DAY) == FIRST + 70 * DAY


def test_what_is_shorter_than_the_time_left_is_not_always_due() -> None:
    assert Threshold(left=30 * DAY).moment(FIRST, FIRST + 20 * DAY) == FIRST + 10 * DAY


@given(
    st.timedeltas(timedelta(hours=1), 9999 * DAY), st.sampled_from([DEFAULT, Threshold(0.01), Threshold(left=30 * DAY)])
)
def test_it_lies_within_the_validity(length: timedelta, threshold: Threshold) -> None:
    moment = threshold.moment(FIRST, FIRST + length)
    assert FIRST <= moment < FIRST + length
    assert moment.microsecond == 0
