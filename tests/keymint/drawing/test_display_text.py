# SPDX-License-Identifier: Apache-2.0
"""Names as display text."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from comarmor.rules import PERMISSIONS
from comarmor.text import printable
from keymint.drawing.display_text import KINDS, shorten


@pytest.mark.parametrize(("text", "shown"), [("/a_b", "/a_b"), ("a\u202eb\x01", "a\\u202eb\\x01"), ("漢", "漢")])
def test_unprintable_characters_are_escaped(text: str, shown: str) -> None:
    assert printable(text) == shown


@given(st.text(max_size=200), st.integers(3, 60))
def test_shortened(text: str, longest: int) -> None:
    found = shorten(text, longest)
    assert len(found) <= longest
    assert found == text or (text.startswith(found.split("…")[0]) and "…" in found)


@pytest.mark.parametrize(
    ("text", "longest", "shown"),
    [
        ("/robot1/navigation/controller_server/set_parameters_atomically", 44, "/robot1/…set_parameters_atomically"),
        ("/robot1/navigation/controller_server/transition_event", 44, "/robot1/navigation/…server/transition_event"),
        ("/" + "x" * 60, 20, "/xxxxx…xxxxxxxxxxxxx"),
        ("/a_b", 44, "/a_b"),
    ],
)
def test_shortened_names_are_cut_between_words(text: str, longest: int, shown: str) -> None:
    assert shorten(text, longest) == shown


def test_pictures_name_every_kind_of_object() -> None:
    assert set(KINDS) == set(PERMISSIONS)
