# SPDX-License-Identifier: Apache-2.0
"""The keystore of a robot: named, found, locked, and cleaned of what a killed run left."""

from __future__ import annotations

import threading
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from keymint.command_line.robot_options import VARIABLE, keystore_of, opened_store
from keymint.errors import ExitCode, KeymintError
from keymint.robots.robot_keystore import Keystore
from keymint.run.run import Run


def run(cwd: Path, **environment: str) -> Run:
    console = SimpleNamespace(waiting=lambda _process: None)
    return cast("Any", SimpleNamespace(setting=SimpleNamespace(cwd=cwd, environment=environment), console=console))


def test_the_option_comes_before_the_environment(tmp_path: Path) -> None:
    there = {VARIABLE: str(tmp_path / "environment")}
    for option, name in ((None, "environment"), (Path("named"), "named")):
        keystore = keystore_of(run(tmp_path, **there), option)
        assert (keystore.root, keystore.shown) == (tmp_path / name, name)


@pytest.mark.parametrize("environment", [{}, {VARIABLE: ""}])
def test_without_either(tmp_path: Path, environment: dict[str, str]) -> None:
    with pytest.raises(KeymintError) as refused:
        keystore_of(run(tmp_path, **environment), None)
    assert refused.value.exit_code is ExitCode.USAGE


def test_what_a_killed_run_left_is_gone(tmp_path: Path) -> None:
    keystore = Keystore(tmp_path, ".")
    (tmp_path / ".keymint").mkdir()
    (tmp_path / ".keymint/running").write_bytes(b"")
    left = tmp_path / "enclaves/.keymint-1-2.tmp"
    left.mkdir(parents=True)
    (left / "key.pem").write_bytes(b"secret")
    with opened_store(run(tmp_path), keystore):
        assert not left.exists()
    assert not (tmp_path / ".keymint/running").exists()


def test_one_at_a_time(tmp_path: Path) -> None:
    keystore, order = Keystore(tmp_path, "."), []

    def second() -> None:
        with opened_store(run(tmp_path), keystore):
            order.append("second")

    with opened_store(run(tmp_path), keystore):
        other = threading.Thread(target=second)
        other.start()
        time.sleep(0.1)
        order.append("first")
    other.join()
    assert order == ["first", "second"]
