# SPDX-License-Identifier: Apache-2.0
"""The periods in which grants are in force, against decisions at single moments."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

import pytest
from hypothesis import given, strategies as st
from keymint_ros2_dds.decision.evaluator import DocumentEvaluator
from keymint_ros2_dds.decision.semantics import CYCLONEDDS_0_10, FASTDDS_2_9, OMG, Variation
from keymint_ros2_dds.proving.grant_periods import grant_periods
from keymint_ros2_dds.reading.signed_permissions import read

from tests.plugins.keymint_ros2_dds.decision.documents import SUBJECT, criteria, document, grant, rule

FIRST = datetime(2026, 1, 1, tzinfo=UTC)
DAYS = st.tuples(st.integers(0, 8), st.integers(0, 8))
VARIATIONS = pytest.mark.parametrize("variation", [OMG, CYCLONEDDS_0_10, FASTDDS_2_9], ids=lambda each: each.name)


def day(number: int) -> datetime:
    return FIRST + timedelta(days=number)


def grants(*days: tuple[int, int], subject: str = SUBJECT) -> bytes:
    """Return a document with a grant for each period, which allows a topic with its number."""
    return document(
        *(
            grant(
                rule("allow", criteria("publish", f"t{number}")),
                validity=(f"{day(first):%Y-%m-%dT%H:%M:%S}", f"{day(last):%Y-%m-%dT%H:%M:%S}"),
                subject=subject,
            )
            for number, (first, last) in enumerate(days)
        )
    )


@VARIATIONS
@given(days=st.lists(DAYS, min_size=1, max_size=4))
def test_at_the_ends_of_a_period_its_grant_decides(variation: Variation, days: list[tuple[int, int]]) -> None:
    loaded = read(grants(*days))
    periods = list(grant_periods(loaded, SUBJECT, variation.semantics))
    numbers = [loaded.grants.index(each.grant) for each in periods]
    assert len(numbers) == len(set(numbers))
    for number, period in zip(numbers, periods, strict=True):
        assert period.begin <= period.end
        for moment in (period.begin, period.end):
            assert DocumentEvaluator(loaded, SUBJECT, moment, 0, variation).decide("publish", f"t{number}").allowed
    for moment in (day(number) + timedelta(hours=1) for number in range(9)):
        evaluator = DocumentEvaluator(loaded, SUBJECT, moment, 0, variation)
        for number in range(len(days)):
            assert number in numbers or not evaluator.decide("publish", f"t{number}").allowed


def test_a_grant_of_another_subject_has_no_period() -> None:
    assert list(grant_periods(read(grants((0, 3), subject="CN=/other")), SUBJECT, OMG.semantics)) == []


@pytest.mark.parametrize("number", [1, 2])
def test_a_period_without_an_end_keeps_its_last_second(number: int) -> None:
    dates = "2026-01-01T00:00:00", "9999-12-31T23:59:59"
    loaded = read(document(*[grant(rule("allow", criteria("publish", "t")), validity=dates)] * number))
    (period,) = grant_periods(loaded, SUBJECT, OMG.semantics)
    assert (period.begin, period.end) == (FIRST, datetime(9999, 12, 31, 23, 59, 59, tzinfo=UTC))
