# SPDX-License-Identifier: Apache-2.0
"""The progress bar on a terminal: only for work that takes long, and only where it is wanted."""

from __future__ import annotations

import io

import pytest

from keymint.output.console import Console, Streams
from keymint.store.changes import Action, Step


def drawn(seconds: float, *, verbosity: int = 0, as_json: bool = False, terminal: bool = True) -> str:
    """Return what work of three steps draws."""
    err, now = io.StringIO(), 0.0
    console = Console(Streams(io.StringIO(), err, progress=terminal), verbosity=verbosity, as_json=as_json)
    with console.progress(3, lambda: now) as advance:
        for stage in ("create", "build", "install"):
            now += seconds
            advance(Step(stage, "talker", Action.UPDATED))
    return err.getvalue()


def test_work_that_takes_long_has_a_bar() -> None:
    shown = drawn(0.6)
    assert "create" not in shown
    assert "install" in shown
    assert "100%" in shown


@pytest.mark.parametrize(
    "setting", [{"seconds": 0.3}, {"verbosity": -1}, {"as_json": True}, {"terminal": False}], ids=str
)
def test_nothing_else_has_one(setting: dict) -> None:
    assert drawn(**{"seconds": 0.6, **setting}) == ""
