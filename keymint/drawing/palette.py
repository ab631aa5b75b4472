# SPDX-License-Identifier: Apache-2.0
"""Colours and line styles of pictures, for light and dark backgrounds, as one style sheet.

Nothing depends on colour alone: arrowheads of denied edges are hollow and barred, false labels are solid and heavy,
false positives have a hazard band and a warning sign, and the legend names every kind of object. The contrast to the
background is at least 4.5 to 1 for text and 3 to 1 for lines (WCAG 2.2, 1.4.3 and 1.4.11).
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum

from keymint.drawing.display_text import KINDS


class Theme(StrEnum):
    """Background of a picture; ``auto`` follows the browser's preference and is light elsewhere."""

    AUTO = "auto"
    LIGHT = "light"
    DARK = "dark"


_COLOURS: Mapping[str, tuple[str, str]] = {
    "background": ("#ffffff", "#11161c"),
    "text": ("#1c2126", "#e6edf3"),
    "muted": ("#57606a", "#9aa4af"),
    "rule": ("#d0d7de", "#39424d"),
    "subject-fill": ("#d9f2dc", "#143a1b"),
    "subject": ("#23762f", "#5fc46b"),
    "ros_topic-fill": ("#dbe9fd", "#122f57"),
    "ros_topic": ("#1f5fae", "#6fa8ff"),
    "ros_service-fill": ("#ecdcf9", "#38204f"),
    "ros_service": ("#7a35a8", "#c58af5"),
    "ros_action-fill": ("#fde8cc", "#46300f"),
    "ros_action": ("#9a5200", "#f2b25c"),
    "ros_parameter-fill": ("#fbdce9", "#4a1c34"),
    "ros_parameter": ("#a8326a", "#f28cb5"),
    "topic-fill": ("#d3f1f2", "#0d3a3e"),
    "topic": ("#0b6a72", "#5cd0d8"),
    "allow": ("#1a7f37", "#4fc36b"),
    "deny": ("#cf222e", "#ff7069"),
    "danger": ("#a40026", "#ff5c7c"),
    "hazard": ("#ffd33d", "#5c4a00"),
    "plain": ("#57606a", "#9aa4af"),
    "audit": ("#9a6700", "#e3b341"),
}
"""On light and on dark backgrounds."""
LIGHT, DARK = ({name: pair[at] for name, pair in _COLOURS.items()} for at in (0, 1))
KIND_NAMES = ("subject", *KINDS)

FONTS = "'DejaVu Sans Mono','Liberation Mono',Menlo,Consolas,'Noto Sans Mono',monospace"
"""Fixed-width fonts of 0.55 to 0.61 em, for which boxes are sized."""

_SHAPES = (
    f".keymint text{{font-family:{FONTS};font-size:12px}}\n"
    """\
.keymint .title{font-size:15px;font-weight:bold}
.keymint .heading{font-size:13px;font-weight:bold}
.keymint .pattern rect{stroke-dasharray:4 3}
.keymint .pattern text{font-style:italic}
.keymint .box rect{stroke-width:1.4}
.keymint .curve{fill:none;stroke-width:1.5}
.keymint .head{stroke-width:1.5;stroke-linejoin:round}
.keymint .true .curve{stroke-dasharray:6 4}
.keymint .false .curve{stroke-width:3.6}
.keymint .false .head{stroke-width:2.4}
.keymint .hazard{fill:none;stroke-width:9}
.keymint .alarm text{font-size:11px;font-weight:bold;text-anchor:middle}
.keymint .group rect{stroke-width:3.2}
.keymint .mark{font-size:11px}
"""
)


def style_sheet(theme: Theme) -> str:
    """Return the style sheet of a picture; renderers without media queries can read it, too."""
    if theme is Theme.AUTO:
        return f"{_SHAPES}{_colours(LIGHT)}@media (prefers-color-scheme:dark){{\n{_colours(DARK)}}}\n"
    return _SHAPES + _colours(LIGHT if theme is Theme.LIGHT else DARK)


def _colours(palette: Mapping[str, str]) -> str:
    rules = [
        f".keymint .background{{fill:{palette['background']}}}",
        f".keymint text{{fill:{palette['text']}}}",
        f".keymint .muted{{fill:{palette['muted']}}}",
        f".keymint .rule{{stroke:{palette['rule']}}}",
        f".keymint .audit{{fill:{palette['audit']};stroke:{palette['background']}}}",
    ]
    rules.append(f".keymint .neutral rect{{fill:{palette['background']};stroke:{palette['plain']}}}")
    for kind in KIND_NAMES:
        rules.append(f".keymint .{kind} rect{{fill:{palette[f'{kind}-fill']};stroke:{palette[kind]}}}")
        rules.append(f".keymint .{kind} .bullet{{fill:{palette[kind]}}}")
    rules.append(f".keymint .hazard{{stroke:{palette['hazard']}}}")
    rules.append(f".keymint .alarm path{{fill:{palette['danger']};stroke:{palette['background']}}}")
    rules.append(f".keymint .alarm text{{fill:{palette['background']}}}")
    for verdict in ("allow", "deny", "danger", "plain"):
        rules.append(f".keymint .{verdict} .curve,.keymint .{verdict} .head{{stroke:{palette[verdict]}}}")
        filled = palette["background"] if verdict == "deny" else palette[verdict]
        rules.append(f".keymint .{verdict} .head{{fill:{filled}}}")
    return "\n".join(rules) + "\n"
