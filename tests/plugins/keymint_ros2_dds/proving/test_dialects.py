# SPDX-License-Identifier: Apache-2.0
"""The expressions of a document as patterns over bytes."""

from __future__ import annotations

import re

import pytest
from hypothesis import given, settings, strategies as st
from keymint_ros2_dds.proving.octets import read
from keymint_ros2_dds.reading import dialects

from comarmor.patterns.glob import matches
from comarmor.patterns.tokens import PatternError
from tests.effort import tries

PIECES = st.sampled_from([*"ab-]/*?!^\\\u00e9", "[ab]", "[!a]", "[a-b]", "[^a]", "[]a]", "[!]]"])
TEXTS = st.text(alphabet="ab/-]!^\\\u00e9", max_size=5)
DIALECTS = (dialects.STANDARD, dialects.FAST_DDS, dialects.CYCLONE_DDS)


@settings(max_examples=tries(60, 300), deadline=None)
@given(st.lists(PIECES, max_size=5).map("".join), TEXTS, st.sampled_from(DIALECTS))
def test_patterns_match_what_the_dialect_matches(expression: str, text: str, dialect) -> None:
    (pattern,) = read((expression,), dialect)
    name = dialects.in_bytes(text)
    expected = re.fullmatch(dialects.translate(dialects.in_bytes(expression), dialect), name, re.DOTALL) is not None
    assert matches(pattern, name) == expected


def test_each_pattern_is_returned_once_in_order() -> None:
    assert [matches(pattern, "b") for pattern in read(("b", "a*", "b", "a**"), dialects.STANDARD)] == [
        True,
        False,
    ]


def test_notation_that_implementations_read_differently_is_an_error() -> None:
    for expression in ("[[:nope:]]", "[[.a.]]", "[[=a=]]"):
        with pytest.raises(PatternError):
            read((expression,), dialects.STANDARD)
