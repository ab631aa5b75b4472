# SPDX-License-Identifier: Apache-2.0
"""Gathered patterns match exactly the names."""

from __future__ import annotations

from itertools import combinations, product
from unittest import mock

from hypothesis import given, strategies as st
from keymint_ros2_dds.compiling import gathering as module
from keymint_ros2_dds.compiling.gathering import Pattern, gather, similar


def expanded(patterns: tuple[Pattern, ...]) -> list[str]:
    return ["".join(letters) for pattern in patterns for letters in product(*pattern)]


@given(st.sets(st.text("ab1-_/]*", max_size=5), max_size=40))
def test_exactly_the_names_and_each_once(names: set[str]) -> None:
    found = gather(names)
    assert sorted(expanded(found)) == sorted(names)


@given(st.sets(st.text("ab-]*", max_size=4), max_size=40))
def test_a_set_holds_plain_characters_and_stands_before_no_dash(names: set[str]) -> None:
    for pattern in gather(names):
        for at, members in enumerate(pattern):
            if len(members) > 1:
                assert members.isalnum()
                assert pattern[at + 1 : at + 2] != ("-",)


def test_numbers_share_a_pattern_for_each_length() -> None:
    found = gather(f"rt/axle{number}" for number in range(1000))
    assert ["".join(p if len(p) == 1 else f"[{p}]" for p in pattern) for pattern in found] == [
        "rt/axle[0123456789]",
        "rt/axle[123456789][0123456789]",
        "rt/axle[123456789][0123456789][0123456789]",
    ]


def test_namespaces_with_the_same_names_share_them() -> None:
    names = [f"rt/{space}/{name}" for space in ("amr1", "amr2", "amr3") for name in ("odom", "scan")]
    assert len(gather(names)) == len({"odom", "scan"})


def test_names_that_have_nothing_in_common_stay() -> None:
    assert gather(["/scan", "/odom"]) == (tuple("/odom"), tuple("/scan"))


@given(st.sets(st.text("ab1-_/]*", max_size=5), max_size=40))
def test_names_that_are_similar_to_no_other_one_need_not_be_tried(names: set[str]) -> None:
    pairs = [{a, b} for a, b in combinations(names, 2) if len(a) == len(b) and sum(map(str.__ne__, a, b)) == 1]
    assert similar(names) == frozenset().union(*pairs)
    found = gather(names)
    with mock.patch.object(module, "similar", frozenset):
        assert gather(names) == found
