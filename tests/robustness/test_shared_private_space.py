# SPDX-License-Identifier: Apache-2.0
"""Two workspaces that share a private space: neither loses what the other one writes to the register."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from comarmor.errors import Origin
from keymint.life.register import Register, loaded_register

from . import scenarios, tracing

Keymint = Callable[..., Any]
VAULT = "vault"
PAUSED = """
import contextlib, importlib, sys
from keymint import cli
from keymint.store import store
module, _, names = sys.argv[1].partition(":")
*path, name = names.split(".")
where = importlib.import_module(module)
for each in path:
    where = getattr(where, each)
there = getattr(where, name)

def paused(*arguments):
    print("paused", flush=True)
    sys.stdin.readline()
    return there(*arguments)

setattr(where, name, paused)
if sys.argv[2] == "unlocked":
    store.path_lock = lambda *arguments: contextlib.nullcontext(False)
sys.exit(cli.main(sys.argv[3:]))
"""
"""Pauses a run of the command line in front of a function, until a line comes."""


@pytest.fixture
def folder(tmp_path: Path, keymint: Keymint) -> Path:
    """Return a folder with two policies, and a way to run the command line with a shared private space."""
    for name in ("one", "two"):
        (tmp_path / f"{name}.xml").write_text(scenarios.policy(f"/{name}", f"/old_{name}"))
    return tmp_path


@pytest.fixture
def made(folder: Path, keymint: Keymint) -> Path:
    for name in ("one", "two"):
        ran = keymint(*provision(folder, name))
        assert ran.code == 0, ran.err
    return folder


def arguments(folder: Path, name: str, *verb: object) -> list[str]:
    return [*map(str, verb), "-w", f"{folder}/{name}", "--private-space", f"{folder}/{VAULT}"]


def provision(folder: Path, name: str) -> list[str]:
    return arguments(folder, name, "provision", folder / f"{name}.xml", "-j", "1")


def revoke(folder: Path, name: str) -> list[str]:
    return arguments(folder, name, "revoke", f"old_{name}", "--reason", "retired")


@pytest.fixture
def pause() -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """Return a function that starts a run which pauses in front of a function."""
    started: list[subprocess.Popen[str]] = []

    def start(place: str, locks: str, command: list[str]) -> subprocess.Popen[str]:
        run = subprocess.Popen(
            [sys.executable, "-c", PAUSED, place, locks, *command],
            env=tracing.environment(), stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        started.append(run)
        assert run.stdout is not None
        assert run.stdout.readline() == "paused\n"
        return run

    yield start
    for run in started:
        run.kill()
        run.communicate()


def ended(run: subprocess.Popen[str]) -> tuple[int, str]:
    """Let a paused run go on; return its exit code and what it said about errors."""
    _, err = run.communicate("\n", timeout=60)
    return run.returncode, err


def register(folder: Path) -> Register:
    path = folder / VAULT / "register.sqlite3"
    return loaded_register(path.read_bytes(), Origin(str(path)))


def revoked(folder: Path) -> set[str]:
    return {each.name for each in register(folder).certificates.values() if each.revoked}


def require_clean(folder: Path, keymint: Keymint) -> None:
    for name in ("one", "two"):
        checked = keymint(*arguments(folder, name, "check", "-q"))
        assert (checked.code, checked.err) == (0, "")


def test_a_run_waits_for_one_in_the_other_workspace(
    made: Path, keymint: Keymint, pause: Callable[..., subprocess.Popen[str]]
) -> None:
    first = pause("keymint.run.run:execute", "locked", revoke(made, "one"))
    second = subprocess.Popen(
        [sys.executable, "-m", "keymint", *revoke(made, "two")],
        env=tracing.environment(), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert second.stderr is not None
    assert "Waiting for the workspace lock" in second.stderr.readline()
    assert revoked(made) == set()
    assert ended(first) == (0, "")
    assert (second.communicate(timeout=60)[1], second.returncode) == ("", 0)
    assert revoked(made) == {"old_one", "old_two"}
    for name in ("one", "two"):  # each authority has one list, which both workspaces publish
        assert keymint(*arguments(made, name, "install")).code == 0
    require_clean(made, keymint)


def test_of_two_that_create_it_the_second_takes_the_keys_of_the_first(
    folder: Path, keymint: Keymint, pause: Callable[..., subprocess.Popen[str]]
) -> None:
    first = pause("keymint.store.store:Store.lock_missing", "locked", provision(folder, "one"))
    assert keymint(*provision(folder, "two")).code == 0
    keys = {path: path.read_bytes() for path in (folder / VAULT).rglob("*.pem")}
    assert ended(first)[0] == 0
    assert {path: path.read_bytes() for path in keys} == keys
    assert {each.name for each in register(folder).certificates.values()} == {"one", "two", "old_one", "old_two"}
    require_clean(folder, keymint)


def test_without_locks_a_register_that_changed_is_an_error_and_nothing_is_lost(
    made: Path, keymint: Keymint, pause: Callable[..., subprocess.Popen[str]]
) -> None:
    """Not every file system locks folders."""
    first = pause("keymint.run.run:require_register", "unlocked", revoke(made, "one"))
    assert keymint(*revoke(made, "two")).code == 0
    code, err = ended(first)
    assert (code, err.count("was changed by another run meanwhile"), "run the command again" in err) == (1, 1, True)
    assert revoked(made) == {"old_two"}
    assert (made / "one/install/enclaves/old_one/cert.pem").exists()
    assert keymint(*revoke(made, "one")).code == 0
    assert revoked(made) == {"old_one", "old_two"}
