# SPDX-License-Identifier: Apache-2.0
"""Tables fit the terminal, nothing is lost, and names are in an order for people."""

from __future__ import annotations

import io
import os
import random
from pathlib import Path

import pytest
from hypothesis import given, strategies as st

from comarmor.text import natural_order
from keymint.output.console import Console, Streams
from tests.conftest import Outcome


def table(rows: list[list[str]], width: int | None) -> list[str]:
    out = io.StringIO()
    columns = {title: title for title in rows[0]}
    console = Console(Streams(out, io.StringIO(), width=width))
    console.table(columns, [dict(zip(columns, row, strict=True)) for row in rows[1:]])
    return out.getvalue().splitlines()


words = st.text(st.characters(min_codepoint=33, max_codepoint=126), min_size=1, max_size=60)
cells = st.lists(words, min_size=1, max_size=4).map(" ".join)
rows_of_three = st.lists(st.lists(cells, min_size=3, max_size=3), min_size=1, max_size=4)


@given(rows_of_three, st.integers(40, 120))
def test_no_line_is_too_long_and_no_character_is_lost(rows: list[list[str]], width: int) -> None:
    lines = table([["A", "B", "C"], *rows], width)
    assert max(map(len, lines)) <= width
    wanted = sorted("ABC" + "".join("".join(row) for row in rows).replace(" ", ""))
    assert sorted("".join(lines).replace(" ", "")) == wanted


@given(rows_of_three)
def test_without_a_terminal_no_word_is_torn(rows: list[list[str]]) -> None:
    found = " ".join(table([["A", "B", "C"], *rows], None)).split()
    assert sorted(found) == sorted(["A", "B", "C", *(word for row in rows for cell in row for word in cell.split())])


def test_a_name_is_folded_after_a_slash() -> None:
    lines = table([["NAME", "STATE"], ["fleet/robot_12/navigation/planner", "in force"]], 30)
    assert lines[1:] == ["fleet/robot_12/       in force", "navigation/planner"]


def fleet(names: list[str]) -> str:
    profiles = "".join(
        f'<profile name="{name}"><attachment>/{name}/node</attachment><ros_topic qualifier="ALLOW">'
        "<attachment>/t</attachment><permissions><ros_publish/></permissions></ros_topic></profile>"
        for name in names
    )
    return f"<profiles>{profiles}</profiles>"


@pytest.fixture
def robots(keymint, tmp_path: Path) -> Path:
    """A workspace of eleven robots, r1 to r11."""
    (tmp_path / "p.xml").write_text(fleet([f"r{number}" for number in range(1, 12)]))
    outcome = keymint("provision", "p.xml", "-w", "ws", "-v")
    assert outcome.code == 0, outcome.err
    (tmp_path / "out").write_text(outcome.out)
    return tmp_path / "ws"


def in_order(outcome: Outcome) -> None:
    found = [word for line in outcome.out.splitlines() for word in line.split() if word.strip("/").endswith("/node")]
    wanted = [f"r{number}/node" for number in range(1, 12)]
    assert [word.strip("/") for word in found] == wanted


@pytest.mark.parametrize(("verb", "width"), [("status", 60), ("status", 80), ("issued", 80), ("issued", 200)])
def test_robots_are_counted_as_people_do(keymint, robots: Path, verb: str, width: int) -> None:
    outcome = keymint(verb, cwd=robots, env={"COLUMNS": f"{width}"})
    in_order(outcome)
    assert max(map(len, outcome.out.splitlines())) <= width


def test_steps_are_in_the_same_order(robots: Path) -> None:
    shown = (robots.parent / "out").read_text().splitlines()
    for stage in ("create", "build", "install"):
        names = [line.split()[2] for line in shown if line.split()[1:2] == [stage] and "/node" in line]
        assert names == [f"r{number}/node" for number in range(1, 12)]


def test_documents_keep_their_order(keymint, robots: Path) -> None:
    packages = keymint("status", "--json", cwd=robots).document["result"]["packages"]
    assert [each["package"] for each in packages] == sorted(each["package"] for each in packages)


def test_the_width_is_80_without_a_terminal(keymint, robots: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("COLUMNS")
    for arguments in (("status",), ("status", "-v"), ("transports",)):
        lines = keymint(*arguments, cwd=robots).out.splitlines()
        table_ = lines[: next((i for i, line in enumerate(lines) if line.startswith(("used only", "ros:"))), None)]
        assert max(map(len, table_)) <= 80
    for wrong in ("", "0", "-3", "wide", "9" * 40):
        assert keymint("status", cwd=robots, env={"COLUMNS": wrong}).code == 0


def test_the_order_of_names() -> None:
    names = ["a", "a1", "a1b", "a2", "a02", "a10", "a10/b1", "a10/b2", "a10/b12", "b", "b" + "9" * 5000]
    shuffled = random.Random(1).sample(names, len(names))
    assert sorted(shuffled, key=natural_order) == ["a", "a1", "a1b", "a02", "a2", *names[5:]]


@given(st.lists(st.text("ab0129/_ é٣²", max_size=6)))
def test_any_names_can_be_sorted(names: list[str]) -> None:
    assert sorted(sorted(names, key=natural_order)) == sorted(names)


def test_the_terminal_counts(tmp_path: Path) -> None:
    """On a terminal of 50 columns nothing is longer."""
    import fcntl
    import pty
    import struct
    import subprocess
    import sys
    import termios

    main, other = pty.openpty()
    fcntl.ioctl(other, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 50, 0, 0))
    environment = {name: value for name, value in os.environ.items() if name not in {"COLUMNS", "NO_COLOR"}}
    done = subprocess.run(
        [sys.executable, "-m", "keymint", "transports", "--color", "never"], stdout=other, env=environment, check=True
    )
    os.close(other)
    shown = b""
    while True:
        try:
            part = os.read(main, 1 << 16)
        except OSError:
            break
        if not part:
            break
        shown += part
    os.close(main)
    lines = shown.decode().splitlines()
    end = next(index for index, line in enumerate(lines) if line.startswith("used only"))
    assert done.returncode == 0
    assert 40 < max(len(line) for line in lines[:end]) <= 50
