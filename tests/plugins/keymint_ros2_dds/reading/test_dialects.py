# SPDX-License-Identifier: Apache-2.0
"""The dialects against what they model: the C library's matcher and, where it is installed, Cyclone DDS's."""

from __future__ import annotations

import ctypes
import re

import pytest
from hypothesis import given, settings, strategies as st
from keymint_ros2_dds.reading import dialects
from keymint_ros2_dds.vendors import probe_builds

from comarmor.patterns.tokens import Dialect
from keymint.host.vendor_process import MissingVendorError
from tests.effort import tries
from tests.plugins.keymint_ros2_dds.decision.cyclone_matcher import ac_fnmatch
from tests.plugins.keymint_ros2_dds.decision.cyclone_reference import cyclone_regex

PIECES = st.sampled_from([*"ab-]/*?[!^\\", "[ab]", "[!a]", "[a-b]", "[^a]", "[[:alpha:]]", "[]a]", "[!]", "rt/"])
PATTERNS = st.lists(PIECES, max_size=6).map("".join)
NAMES = st.text(alphabet="abrt/-]![^\\c", max_size=6)
NOESCAPE = 2

libc = ctypes.CDLL(None)
thorough = settings(max_examples=tries(100, 600), deadline=None)


def matches(dialect: Dialect, pattern: str, name: str) -> bool:
    return re.fullmatch(dialects.translate(pattern, dialect), name, re.DOTALL) is not None


@thorough
@given(PATTERNS, NAMES)
def test_fast_dds_is_the_c_library_without_escapes(pattern: str, name: str) -> None:
    expected = libc.fnmatch(pattern.encode(), name.encode(), NOESCAPE) == 0
    assert matches(dialects.FAST_DDS, pattern, name) == expected


@thorough
@given(PATTERNS, NAMES)
def test_the_standard_is_the_c_library(pattern: str, name: str) -> None:
    expected = libc.fnmatch(pattern.encode(), name.encode(), 0) == 0
    assert matches(dialects.STANDARD, pattern, name) == expected


@thorough
@given(PATTERNS, NAMES)
def test_cyclone_dds_is_its_reference(pattern: str, name: str) -> None:
    expected = re.fullmatch(cyclone_regex(pattern), name, re.DOTALL) is not None
    assert matches(dialects.CYCLONE_DDS, pattern, name) == expected


@pytest.mark.cyclonedds
def test_cyclone_dds_has_a_matcher_of_its_own() -> None:
    try:
        probe_builds.require_cyclone_plugins()
    except MissingVendorError as error:
        pytest.skip(str(error))

    @thorough
    @given(PATTERNS, NAMES)
    def check(pattern: str, name: str) -> None:
        assert matches(dialects.CYCLONE_DDS, pattern, name) == ac_fnmatch(pattern.encode(), name.encode())

    check()


@pytest.mark.parametrize(
    ("pattern", "standard", "cyclone", "fast"),
    [
        (r"\*", ["*"], ["\\", r"\a"], ["\\", r"\a"]),
        ("[^a]", ["b", "^", "]"], ["a", "^", "]"], ["b", "^", "]"]),
        ("[a]", ["a"], ["a", "]"], ["a"]),
        ("[!a]", ["b", "^", "]"], ["b", "^"], ["b", "^", "]"]),
        ("[a]-x", ["a-x"], ["a", "x"], ["a-x"]),
        ("[!]", ["[!]"], ["b]"], ["[!]"]),
    ],
)
def test_row_17_where_dialects_differ(pattern: str, standard: list[str], cyclone: list[str], fast: list[str]) -> None:
    for dialect, found in (
        (dialects.STANDARD, standard),
        (dialects.CYCLONE_DDS, cyclone),
        (dialects.FAST_DDS, fast),
    ):
        names = {*standard, *cyclone, *fast}
        assert {name for name in names if matches(dialect, pattern, name)} >= set(found)
        assert [name for name in found if not matches(dialect, pattern, name)] == []


@given(
    st.sampled_from([dialects.STANDARD, dialects.FAST_DDS, dialects.CYCLONE_DDS]),
    st.text(max_size=8),
    st.text(max_size=8),
)
def test_any_text_is_a_pattern(dialect: Dialect, pattern: str, name: str) -> None:
    found = matches(dialect, dialects.in_bytes(pattern), dialects.in_bytes(name))
    if dialects.is_plain(pattern):
        assert found == (pattern == name)


@pytest.mark.parametrize("dialect", [dialects.STANDARD, dialects.FAST_DDS, dialects.CYCLONE_DDS])
def test_no_pattern_takes_long(dialect: Dialect) -> None:
    """A document made by hand must not hang a verification: this took years by trying every place of every star."""
    assert not matches(dialect, "*a" * 40 + "*b", "a" * 200)
    assert matches(dialect, "*a" * 40 + "*b", "a" * 200 + "b")
