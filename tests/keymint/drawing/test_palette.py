# SPDX-License-Identifier: Apache-2.0
"""The contrast of the palettes."""

from __future__ import annotations

import pytest

from keymint.drawing.palette import DARK, KIND_NAMES, LIGHT


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
