# SPDX-License-Identifier: Apache-2.0
"""Expressions that are names: they match themselves and nothing else, in every dialect."""

from __future__ import annotations

import re

from hypothesis import given, strategies as st
from keymint_ros2_dds.lowering.lowered_rules import is_name
from keymint_ros2_dds.reading import dialects

TEXTS = st.lists(st.sampled_from([*"ab/-!^]", "*", "?", "[ab]", "\\"]), max_size=5).map("".join)
DIALECTS = (dialects.STANDARD, dialects.FAST_DDS, dialects.CYCLONE_DDS)


@given(TEXTS, TEXTS)
def test_a_name_matches_itself_only(expression: str, text: str) -> None:
    if is_name(expression):
        for dialect in DIALECTS:
            pattern = re.compile(dialects.translate(expression, dialect), re.DOTALL)
            assert pattern.fullmatch(expression)
            assert bool(pattern.fullmatch(text)) == (text == expression)


@given(TEXTS, TEXTS, st.sampled_from("*?[\\"))
def test_special_characters_make_no_name(head: str, tail: str, char: str) -> None:
    assert not is_name(head + char + tail)
