# SPDX-License-Identifier: Apache-2.0
"""The page about tables shows what happens."""

from __future__ import annotations

import re
import shlex
import sqlite3
from contextlib import closing
from pathlib import Path

from tests.conftest import CHECKOUT
from tests.pages import is_shown, steps_of

PAGE = CHECKOUT / "docs/tables.md"


def block(language: str) -> str:
    (found,) = re.findall(rf"```{language}\n(.*?)```", PAGE.read_text(), re.DOTALL)
    return found


def test_the_examples_work(keymint, tmp_path: Path) -> None:
    (tmp_path / "rules.csv").write_text(block("csv"))
    with closing(sqlite3.connect(tmp_path / "fleet.db")) as database:
        database.executescript(block("sql"))
        database.execute("VACUUM INTO ?", [str(tmp_path / "rules.db")])
    steps = steps_of(PAGE.read_text())
    for step in steps:
        outcome = keymint(*shlex.split(step.what)[1:])
        assert (outcome.code, outcome.err) == (0, "")
        assert is_shown(outcome.out, step.content), outcome.out
    assert len(steps) == 6


def test_the_error_on_the_page(keymint, tmp_path: Path) -> None:
    (tmp_path / "rules.csv").write_text(block("csv").replace("ALLOW,1", "ALOW,1"))
    outcome = keymint("lint", "rules.csv")
    assert (outcome.code, f"`{outcome.err.strip()}`" in PAGE.read_text()) == (1, True)
