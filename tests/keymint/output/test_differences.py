# SPDX-License-Identifier: Apache-2.0
"""The differences of two policies, as text and as Markdown."""

from __future__ import annotations

import re

from hypothesis import given, strategies as st

from comarmor.errors import Origin
from comarmor.patterns.glob import parse
from keymint.analysis.permission_changes import PermissionChange
from keymint.analysis.policy_diff import SubjectChanges
from keymint.output.differences import _code, as_text, markdown, summary

GAIN = PermissionChange(
    gains=True,
    kind="ros_topic",
    permission="ros_publish",
    objects=parse("/a/*"),
    whole=True,
    word="/a/",
    where=Origin("new.xml", 4),
)
LOSS = PermissionChange(
    gains=False,
    kind="ros_topic",
    permission="ros_subscribe",
    objects=parse("/b|c"),
    whole=True,
    word="/b|c",
    where=Origin("lib/common/node.xml", 9),
)


def place(where: Origin | None) -> str:
    return str(where or "")


def lines_of(*changes: SubjectChanges) -> list[str]:
    library = {"lib/common/node.xml": "common/node.xml"}.get
    return list(markdown(changes, place, library, ("old", "new")))


def test_gains_and_losses_have_a_line_each() -> None:
    changes = SubjectChanges("/robot", None, before=True, after=True, changes=(GAIN, LOSS))
    assert list(as_text([changes], place)) == [
        "/robot:",
        "  + ros_publish /a/*, e.g. /a/ (new.xml:4)",
        "  - ros_subscribe /b|c (lib/common/node.xml:9)",
    ]
    assert summary([changes]) == "1 subject gains, 1 loses"


def test_cells_escape_the_separator_of_columns() -> None:
    lines = lines_of(SubjectChanges("/robot", None, before=True, after=True, changes=(GAIN, LOSS)))
    assert "| gains | `ros_publish` | `/a/*`, e.g. `/a/` | `new.xml:4` |" in lines
    assert "| loses | `ros_subscribe` | `/b\\|c` | `lib/common/node.xml:9` |" in lines


def test_a_new_node_gets_one_line_for_each_file_of_the_library() -> None:
    lines = lines_of(SubjectChanges("/robot", None, before=False, after=True, changes=(GAIN, LOSS)))
    assert "#### `/robot` (new)" in lines
    assert "… and the rule of `common/node.xml` (library)" in lines
    assert not any("/b" in line for line in lines)


def test_equivalent_policies() -> None:
    assert lines_of()[-1] == "**Equivalent**: no subject gains or loses anything."
    assert summary([]) == "equivalent: no subject gains or loses anything"


@given(st.text("a`|\\ @*", min_size=1, max_size=8))
def test_no_text_ends_a_code_span_or_a_cell_of_a_table(text: str) -> None:
    span = _code(text)
    cells = re.sub(r"\\(?:[!-/:-@\[-`{-~])", "", span)  # GFM: a backslash escapes punctuation before cells are split
    assert "|" not in cells
    opened = re.match("`+", span)
    assert opened
    fence = opened[0]
    inner = span[len(fence) : -len(fence)]
    assert span.endswith(fence)
    assert not re.search(rf"(?<!`){fence}(?!`)", inner)
    assert not inner.startswith("`")
    assert not inner.endswith("`")
