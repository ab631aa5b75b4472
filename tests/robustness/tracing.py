# SPDX-License-Identifier: Apache-2.0
"""Disturbs a run at a chosen system call: kills it, interrupts it, or makes the call fail."""

from __future__ import annotations

import atexit
import functools
import json
import os
import re
import shutil
import subprocess
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest

from .launcher import HARMLESS
from .memory import in_memory

HERE = Path(__file__).parent
CALLS = ",".join(HARMLESS)
_MARGIN = 100
"""Number of additional calls of a kind that starting Python may make."""
_LINE = re.compile(r"(?P<process>\d+) +(?P<call>\w+)\((?P<rest>.*)")


@dataclass(frozen=True)
class Point:
    """A call that changes the workspace: its name, and its number among the calls of that name in its process."""

    call: str
    number: int
    text: str

    def __str__(self) -> str:
        return f"{self.call} {self.number}: {self.text}"


@dataclass(frozen=True)
class Trace:
    """An undisturbed run.

    Attributes:
        points: in order, the calls that may change the workspace.
        strikes: for each kind of call a number that no process reaches of itself.
        ended: how it ended.
    """

    points: Sequence[Point]
    strikes: Mapping[str, int]
    ended: Ended


@dataclass(frozen=True)
class Ended:
    """The result of a run: its exit code, or the negative number of the signal that killed it."""

    code: int
    output: str


@functools.cache
def require_strace() -> None:
    """Skip the test if tracing is impossible; fail if CI requires it."""
    problem = "" if shutil.which("strace") else "strace is not installed"
    if not problem:
        try:
            with in_memory() as folder:
                _launch([], ["-o", os.devnull], folder)
        except subprocess.CalledProcessError as error:
            problem = error.stderr.strip()
    if problem and os.environ.get("KEYMINT_REQUIRE_VENDORS") == "1":
        pytest.fail(f"KEYMINT_REQUIRE_VENDORS=1, but nothing can be traced: {problem}", pytrace=False)
    if problem:
        pytest.skip(f"nothing can be traced: {problem}")


def environment() -> dict[str, str]:
    """Return an environment in which every run makes the same calls."""
    names = ("PATH", "HOME", "PYTHONPATH", "PYTHONPYCACHEPREFIX", "SOURCE_DATE_EPOCH")
    kept = {name: os.environ[name] for name in names if name in os.environ}
    return kept | {"PYTHONDONTWRITEBYTECODE": "1", "PYTHONHASHSEED": "0", "LC_ALL": "C.UTF-8"}


@functools.cache
def _launcher(variables: frozenset[tuple[str, str]]) -> subprocess.Popen[str]:
    """Return a process that ran the command line already, and runs jobs in forks of it, until this process ends."""
    command = [sys.executable, str(HERE / "launcher.py")]
    launcher = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=dict(variables))
    atexit.register(launcher.communicate)
    return launcher


def _launch(jobs: Sequence[tuple[list[str], str, int]], options: list[str], folder: Path) -> list[tuple[int, Ended]]:
    (folder / "jobs").write_text(json.dumps(jobs))
    (folder / "results").unlink(missing_ok=True)
    launcher = _launcher(frozenset(environment().items()))
    assert launcher.stdin is not None
    assert launcher.stdout is not None
    print(folder / "jobs", folder / "results", file=launcher.stdin, flush=True)
    process = launcher.stdout.readline().strip()
    strace = ["strace", "-f", "-q", *options, "-p", process]
    subprocess.run(strace, check=True, capture_output=True, text=True, timeout=600)
    results = json.loads((folder / "results").read_text())
    return [(process, Ended(code, output)) for process, code, output in results]


def trace(arguments: list[str], workspace: Path, folder: Path) -> Trace:
    """Run a command line, undisturbed.

    Args:
        arguments: the command line.
        workspace: the workspace, or a folder around it.
        folder: a folder for the files of this.
    """
    log = folder / "log"
    [(process, ended)] = _launch([(arguments, "", 0)], ["-y", "-o", str(log), "-e", f"trace={CALLS}"], folder)
    found: list[Point] = []
    counted: dict[int, Counter[str]] = {}
    for line in log.read_text(errors="replace").splitlines():
        match = _LINE.match(line)
        if not match:
            continue
        call, rest = match["call"], match["rest"]
        counter = counted.setdefault(int(match["process"]), Counter())
        counter[call] += 1
        reads = call == "openat" and "O_CREAT" not in rest
        says = f"{folder}/results.output>" in rest  # a message that names the workspace changes nothing in it
        if int(match["process"]) == process and str(workspace) in rest and not reads and not says:
            found.append(Point(call, counter[call], rest.replace(str(workspace), "…")))
    strikes = {call: max(counter[call] for counter in counted.values()) + _MARGIN for call in HARMLESS}
    return Trace(found, strikes, ended)


def strike(how: str, struck: Sequence[tuple[Point, list[str]]], traced: Trace, folder: Path) -> list[Ended]:
    """Run command lines, each disturbed at its own call.

    Args:
        how: ``signal=SIGKILL``, ``signal=SIGINT``, ``error=ENOSPC``, …; see strace(1), "Tampering".
        struck: points of the undisturbed run, and the command lines.
        traced: the undisturbed run.
        folder: a folder for the files of this.
    """
    # What starts the jobs makes a few calls for each.
    strikes = {call: number + 5 * len(struck) for call, number in traced.strikes.items()}
    jobs = [(arguments, point.call, strikes[point.call] - point.number) for point, arguments in struck]
    options = ["-o", os.devnull, "-e", f"trace={CALLS}"]
    for call, number in strikes.items():
        options += ["-e", f"inject={call}:{how}:when={number}"]
    return [ended for _, ended in _launch(jobs, options, folder)]
