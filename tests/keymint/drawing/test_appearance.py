# SPDX-License-Identifier: Apache-2.0
"""Names as display text."""

from __future__ import annotations

import pytest
from hypothesis import given, strategies as st

from comarmor.rules import PERMISSIONS
from comarmor.text import one_line
from keymint.drawing.appearance import DARK, KIND_NAMES, KINDS, LIGHT, shorten


@pytest.mark.parametrize(("text", "shown"), [("/a_b", "/a_b"), ("a\u202eb\x01", "a\\u202eb\\x01"), ("漢", "漢")])
def test_unprintable_characters_are_escaped(text: str, shown: str) -> None:
    assert one_line(text) == shown


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


def luminance(colour: str) -> float:
    """Relative luminance (WCAG 2.2)."""
    parts = [int(colour[at : at + 2], 16) / 255 for at in (1, 3, 5)]
    linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def contrast(one: str, other: str) -> float:
    light, dark = sorted((luminance(one), luminance(other)), reverse=True)
    return (light + 0.05) / (dark + 0.05)


@pytest.mark.parametrize("palette", [LIGHT, DARK], ids=["light", "dark"])
def test_contrast(palette: dict[str, str]) -> None:
    background = palette["background"]
    assert contrast(palette["muted"], background) >= 4.5
    for kind in KIND_NAMES:
        assert contrast(palette["text"], palette[f"{kind}-fill"]) >= 4.5
        assert contrast(palette[kind], background) >= 3
    for line in ("allow", "deny", "danger", "plain", "audit"):
        assert contrast(palette[line], background) >= 3
    for sign in ("allow", "deny", "danger", "plain"):  # a letter of one colour on the other
        assert contrast(palette[sign], background) >= 4.5
