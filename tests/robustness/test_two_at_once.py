# SPDX-License-Identifier: Apache-2.0
"""Two runs in one workspace at once: one waits, and reports it."""

from __future__ import annotations

import fcntl
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn

import pytest

from keymint.errors import KeymintError

from . import scenarios, tracing

Keymint = Callable[..., Any]


def start(folder: Path, *arguments: object) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "keymint", *map(str, arguments), "-w", folder / "ws"],
        env=tracing.environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "policy.xml").write_text(scenarios.policy("/robot/talker", "/listener"))
    return tmp_path


def require_clean(folder: Path, keymint: Keymint) -> None:
    checked = keymint("check", "-q", "-w", folder / "ws")
    assert (checked.code, checked.err) == (0, "")
    again = keymint("provision", folder / "policy.xml", "-w", folder / "ws")
    assert "nothing to do" in again.out


def test_a_run_that_waits_for_the_workspace_lock_reports_it_and_then_does_its_work(
    folder: Path, keymint: Keymint
) -> None:
    assert keymint("init", folder / "ws", "--policy", folder / "policy.xml").code == 0
    with (folder / "ws" / ".keymint" / "lock").open("r+") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        runs = [start(folder, "provision", folder / "policy.xml") for _ in range(2)]
        for run in runs:
            assert run.stderr is not None
            assert "Waiting for the workspace lock" in run.stderr.readline()
            assert run.poll() is None
        assert not (folder / "ws" / "src").exists()
    said = [run.communicate(timeout=60) for run in runs]
    assert [run.returncode for run in runs] == [0, 0]
    assert all(": note: " in line for _, err in said for line in err.splitlines())
    # One does all of it, and the other sees that it is done.
    assert sorted("nothing to do" in out for out, _ in said) == [False, True]
    require_clean(folder, keymint)


def test_two_runs_that_create_the_workspace_both_succeed(folder: Path, keymint: Keymint) -> None:
    runs = [start(folder, "provision", folder / "policy.xml") for _ in range(3)]
    said = [run.communicate(timeout=60) for run in runs]
    assert [run.returncode for run in runs] == [0, 0, 0], said
    assert sum("nothing to do" in out for out, _ in said) == 2
    require_clean(folder, keymint)


READERS = (["check", "-q"], ["status"], ["prove"], ["verify", "-i", "omg"], ["install", "--dry-run"])


@pytest.mark.parametrize("verb", READERS, ids=lambda verb: verb[0])
def test_a_reader_waits_for_a_writer_but_not_for_another_reader(
    folder: Path, keymint: Keymint, verb: list[str]
) -> None:
    assert keymint("provision", folder / "policy.xml", "-w", folder / "ws").code == 0
    with (folder / "ws" / ".keymint" / "lock").open("r+") as lock:
        fcntl.flock(lock, fcntl.LOCK_SH)
        looked = keymint(*verb, "-w", folder / "ws")
        assert (looked.code, looked.err) == (0, "")
        fcntl.flock(lock, fcntl.LOCK_EX)
        run = start(folder, *verb)
        assert run.stderr is not None
        assert "Waiting for the workspace lock" in run.stderr.readline()
        assert run.poll() is None
    out, err = run.communicate(timeout=60)
    assert (run.returncode, err) == (0, ""), out


def test_no_reader_sees_the_unfinished_work_of_a_running_install(folder: Path, keymint: Keymint) -> None:
    names = ("/robot", "/robot/talker", "/robot/arm", "/listener")
    (folder / "policy.xml").write_text(scenarios.policy(*names))
    assert keymint("provision", folder / "policy.xml", "-w", folder / "ws").code == 0
    renewals = subprocess.Popen(
        [sys.executable, "-c", _RENEW, *map(str, (folder / "policy.xml", folder / "ws"))],
        env=tracing.environment(), stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    looked = 0
    while renewals.poll() is None:
        checked = keymint("check", "-w", folder / "ws", "--json")
        assert (checked.code, {*checked.codes()}) == (0, {"node-cannot-start"}), checked.out
        rows = keymint("status", "-w", folder / "ws", "--json").document["result"]["packages"]
        assert {(row["stage"], row["stale"]) for row in rows} == {("installed", None)}
        looked += 1
    assert renewals.communicate()[0].split() == ["0"] * 12
    assert looked > 2


_RENEW = """
import sys
from keymint import cli
for _ in range(12):
    print(cli.main(["provision", sys.argv[1], "-w", sys.argv[2], "--rekey=*", "--yes", "-q"]), flush=True)
"""


def test_a_plan_that_fails_because_another_run_creates_the_workspace_is_made_again(
    folder: Path, keymint: Keymint
) -> None:
    def meanwhile(*_arguments: object, **_options: object) -> NoReturn:
        patch.undo()
        other = start(folder, "provision", folder / "policy.xml")
        other.communicate(timeout=60)
        assert other.returncode == 0
        raise KeymintError("a file of the workspace is missing")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("keymint.stages.pipeline.plan_authorities", meanwhile)
        outcome = keymint("provision", folder / "policy.xml", "-w", folder / "ws")
    assert (outcome.code, outcome.err) == (0, "")
    assert "nothing to do" in outcome.out
    require_clean(folder, keymint)
