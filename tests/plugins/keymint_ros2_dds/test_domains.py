# SPDX-License-Identifier: Apache-2.0
"""Ranges of DDS domain ids."""

from __future__ import annotations

import itertools

import pytest
from hypothesis import given, strategies as st
from keymint_ros2_dds.domains import MAX_DOMAIN, check_domains, in_words, merged_domains, uncovered_domains

from keymint.api import DomainRange
from tests.plugins.keymint_ros2_dds.packages import ORIGIN

RANGES = st.lists(
    st.builds(lambda first, more: DomainRange(first, first + more), st.integers(0, 30), st.integers(0, 5)), max_size=6
)


def ids(ranges) -> set[int]:
    return {number for each in ranges for number in range(each.first, each.last + 1)}


@given(RANGES)
def test_merged_ranges_have_the_same_ids_in_order_and_with_gaps(ranges) -> None:
    result = merged_domains(ranges)
    assert ids(result) == ids(ranges)
    assert all(before.last + 1 < after.first for before, after in itertools.pairwise(result))


@given(RANGES, RANGES)
def test_a_range_is_covered_if_all_its_ids_are(ranges, covering) -> None:
    assert uncovered_domains(ranges, covering) == tuple(each for each in ranges if not ids([each]) <= ids(covering))


@pytest.mark.parametrize(
    ("ranges", "text"),
    [
        ([(3, 3)], "domain 3"),
        ([(3, 5)], "domains 3 to 5"),
        ([(4, 5), (3, 3)], "domains 3 to 5"),
        ([(7, 7), (0, 0), (3, 5)], "domains 0, 3 to 5, 7"),
    ],
)
def test_in_words(ranges, text: str) -> None:
    assert in_words(DomainRange(*each) for each in ranges) == text


@pytest.mark.parametrize(
    ("ranges", "codes"),
    [
        ([(0, MAX_DOMAIN)], []),
        ([], ["domains"]),
        ([(2, 1), (-1, 3)], ["domains", "domains"]),
        ([(0, 0), (0, MAX_DOMAIN + 1)], ["portability-domain"]),
    ],
)
def test_ids_that_cannot_be_used_are_errors(ranges, codes: list[str]) -> None:
    found = list(check_domains([DomainRange(*each) for each in ranges], ORIGIN, "/s"))
    assert [each.code for each in found] == codes
    assert all(each.where == ORIGIN and each.subject == "/s" and each.help for each in found)
