# SPDX-License-Identifier: Apache-2.0
"""A run disturbed at any system call leaves complete files, and a later run completes its work.

With ``KEYMINT_FULL=1`` every call that may change the workspace is disturbed in turn, otherwise a sample of them.
"""

from __future__ import annotations

import filecmp
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from tests.effort import FULL

from . import scenarios, tracing
from .memory import in_memory
from .scenarios import PROVISION, SCENARIOS, Scenario
from .tracing import Ended, Point, Trace

pytestmark = pytest.mark.strace

Keymint = Callable[..., Any]
CRITICAL = frozenset({"renameat", "renameat2", "rmdir", "unlink"})
"""The calls that change the visible files."""
IN_ORDER = 5
"""Number of calls of one kind to disturb, evenly spread over the run."""
KILLED = 3
"""The same for the runs that are killed, of which there are many kinds; each begins at another call."""


@pytest.fixture(autouse=True)
def strace(plain_environment: None) -> None:
    tracing.require_strace()


@dataclass(frozen=True)
class Prepared:
    """A scenario that ran undisturbed, and the state in which the disturbed runs start."""

    scenario: Scenario
    start: Path
    traced: Trace
    tree: Mapping[str, str]
    keys: Mapping[str, bytes]
    before: Mapping[str, Mapping[str, bytes]]
    after: Mapping[str, Mapping[str, bytes]]

    def copy(self, to: Path) -> Path:
        """Copy the start state of the run; a workspace knows its own name, but not its path."""
        shutil.copytree(self.start, to)
        return to


Prepare = Callable[[str], Prepared]


@pytest.fixture(scope="module")
def made() -> Iterator[tuple[Path, dict[str, Prepared]]]:
    """Return a folder for the scenarios that several tests disturb, and those that are there."""
    with in_memory() as folder:
        yield folder, {}


@pytest.fixture
def prepare(made: tuple[Path, dict[str, Prepared]], keymint: Keymint) -> Prepare:
    """Return a function that prepares a scenario once."""
    folder, known = made

    def prepared(name: str) -> Prepared:
        if name not in known:
            known[name] = _prepared(name, folder / name, keymint)
        return known[name]

    return prepared


def of_scenario(name: str) -> Any:
    """Return the parameter of a scenario: one process makes all tests of it, and prepares it once."""
    return pytest.param(name, marks=pytest.mark.xdist_group(f"kill {name}"), id=name)


def _prepared(name: str, folder: Path, keymint: Keymint) -> Prepared:
    scenario = SCENARIOS[name]
    folder.mkdir()
    start = folder / "start"
    start.mkdir()
    (start / "policy.xml").write_text(scenarios.policy("/robot/talker", "/listener"))
    for change in scenario.before:
        change(start)
        assert keymint(*[argument.format(start) for argument in PROVISION]).code == 0
    scenario.change(start)
    undisturbed = folder / "undisturbed"
    shutil.copytree(start, undisturbed)
    traced = tracing.trace(scenario.arguments(undisturbed), undisturbed, folder)
    assert traced.ended.code == 0, traced.ended.output
    assert {"renameat", "fsync", "write", "openat", "unlink"} <= {point.call for point in traced.points}
    return Prepared(
        scenario,
        start,
        traced,
        scenarios.tree(undisturbed / "ws"),
        scenarios.keys(undisturbed / "ws"),
        scenarios.enclaves(start / "ws"),
        scenarios.enclaves(undisturbed / "ws"),
    )


def chosen(points: Sequence[Point], most: int, first: int = 0) -> list[Point]:
    """Return the calls to disturb: for each kind of call, some spread over the run; also the last one that is visible.

    Args:
        points: all calls.
        most: how many calls of a kind that changes the visible files.
        first: which ones, in rotation.
    """
    if FULL:
        return list(points)
    kept: list[Point] = []
    for call in sorted({point.call for point in points}):
        of_kind = [point for point in points if point.call == call]
        limit = most if call in CRITICAL else max(1, most // 4)
        step = max(1, -(-len(of_kind) // limit))
        kept += [*of_kind[first % step :: step], *(of_kind[-1:] if call in CRITICAL else ())]
    return sorted(set(kept), key=points.index)


def require_convergence(prepared: Prepared, folder: Path, keymint: Keymint) -> None:
    """Check that running again completes the work of the disturbed run."""
    workspace = folder / "ws"
    minted = scenarios.keys(workspace)
    again = keymint(*prepared.scenario.arguments(folder))
    assert again.code == 0, again.err
    assert scenarios.tree(workspace) == prepared.tree
    now = scenarios.keys(workspace)
    if scenarios.KEYS_MOVE & set(prepared.scenario.verb):
        assert now == prepared.keys
    elif not {"--rekey=*", "--rekey"} & {*prepared.scenario.verb}:
        kept = {name: key for name, key in minted.items() if name in prepared.keys}  # 'remove' takes one away
        assert {name: now.get(name) for name in kept} == kept
    checked = keymint("check", "-q", *scenarios.unproven(prepared.scenario), "-w", workspace)
    assert (checked.code, checked.err) == (0, "")
    scenarios.require_whole_files(workspace)


def looks(workspace: Path, start: Path) -> frozenset[tuple[str, str, bool]]:
    """Return what is not swept away: each path, its mode, and whether it is as it was."""
    return frozenset(
        (path, mode, mode[0] == "-" and (start / path).is_file() and filecmp.cmp(workspace / path, start / path, False))
        for path, mode in scenarios.tree(workspace).items()
        if ".keymint-" not in path
    )


def disturb(
    prepared: Prepared,
    how: str,
    points: Sequence[Point],
    folder: Path,
    keymint: Keymint,
    require: Callable[[Ended, Point], None],
) -> None:
    """Disturb copies of a run, each at its own call; check each afterwards, and again after another run.

    The sample makes no other run in a workspace that looks like one that converged already.
    """
    assert points
    converged: set[frozenset[tuple[str, str, bool]]] = set()
    copies = [prepared.copy(folder / f"{how}-{at}") for at in range(len(points))]
    struck = [(point, prepared.scenario.arguments(copy)) for point, copy in zip(points, copies, strict=True)]
    for (point, _), copy, ended in zip(
        struck, copies, tracing.strike(how, struck, prepared.traced, folder), strict=True
    ):
        try:
            require(ended, point)
            scenarios.require_whole_files(copy / "ws")
            scenarios.require_whole_enclaves(copy / "ws", prepared.before, prepared.after)
            look = looks(copy / "ws", prepared.start / "ws")
            if FULL or look not in converged:
                converged.add(look)
                require_convergence(prepared, copy, keymint)
        except Exception as error:
            error.add_note(f"struck at {point}\n{ended.output}")
            raise
        shutil.rmtree(copy)


def one_line(ended: Ended) -> str:
    """Return the only line that a failed run printed, beside what it said of its plan."""
    planned = re.compile(r": (warning|note): |subjects? gains?, ")
    [line] = (line for line in ended.output.splitlines() if line and not planned.search(line))
    return line


@pytest.mark.parametrize("name", [of_scenario(name) for name in SCENARIOS if FULL or name not in scenarios.RARE])
def test_a_run_killed_at_any_call_converges(name: str, prepare: Prepare, memory: Path, keymint: Keymint) -> None:
    prepared = prepare(name)

    def killed(ended: Ended, _point: Point) -> None:
        assert ended.code == -9

    points = chosen(prepared.traced.points, KILLED, [*SCENARIOS].index(name))
    disturb(prepared, "signal=SIGKILL", points, memory, keymint, killed)


@pytest.mark.parametrize("name", [of_scenario("fresh"), of_scenario("update")])
def test_a_run_interrupted_at_any_call_reports_it_and_converges(
    name: str, prepare: Prepare, memory: Path, keymint: Keymint
) -> None:
    prepared = prepare(name)

    def interrupted(ended: Ended, point: Point) -> None:
        last = point == prepared.traced.points[-1]
        if last and ended.code == 0:
            return  # all was done when the signal came
        assert ended.code == 130
        assert "interrupted" in one_line(ended)

    disturb(prepared, "signal=SIGINT", chosen(prepared.traced.points, IN_ORDER // 3), memory, keymint, interrupted)


@pytest.mark.xdist_group("kill update")
@pytest.mark.parametrize(("error", "message"), [("ENOSPC", "No space left on device"), ("EACCES", "Permission denied")])
def test_a_failing_call_is_reported_in_one_line_and_a_later_run_converges(
    error: str, message: str, prepare: Prepare, memory: Path, keymint: Keymint
) -> None:
    prepared = prepare("update")

    def refused(ended: Ended, _point: Point) -> None:
        assert ended.code == 1
        line = one_line(ended)
        assert message in line
        assert "internal error" not in line
        assert re.search("/ws[/:]", line)

    points = [point for point in prepared.traced.points if point.call != "mkdir"]  # asked again, when it fails
    disturb(prepared, f"error={error}", chosen(points, IN_ORDER // 2), memory, keymint, refused)


@pytest.mark.xdist_group("kill prune")
def test_a_failing_prune_is_reported_in_one_line_and_a_later_one_converges(
    prepare: Prepare, memory: Path, keymint: Keymint
) -> None:
    prepared = prepare("prune")

    def refused(ended: Ended, _point: Point) -> None:
        assert ended.code == 1
        assert "Input/output error" in one_line(ended)

    points = [point for point in prepared.traced.points if point.call != "rmdir"]  # a parent that stays is no failure
    disturb(prepared, "error=EIO", chosen(points, IN_ORDER // 2), memory, keymint, refused)


# -- the command itself ------------------------------------------------------------------------


def command(folder: Path, *options: str) -> list[str]:
    return [sys.executable, "-m", "keymint", "provision", f"{folder}/policy.xml", "-w", f"{folder}/ws", *options]


@pytest.fixture
def robots(memory: Path) -> Path:
    """Return a folder with a policy of several namespaces, so that several processes may work."""
    names = [f"/robot{number}/{node}" for number in range(4) for node in ("talker", "listener")]
    (memory / "policy.xml").write_text(scenarios.policy(*names))
    return memory


@pytest.mark.parametrize("number", [1, 3, 5, 9])
def test_a_command_that_is_killed_while_it_writes_converges(robots: Path, keymint: Keymint, number: int) -> None:
    # The calls of each process are counted by themselves.
    inject = ["-e", "trace=renameat", "-e", f"inject=renameat:signal=SIGKILL:when={number}"]
    ran = subprocess.run(
        ["strace", "-f", "-q", "-o", os.devnull, *inject, *command(robots, "-j", "4")],
        env=tracing.environment(),
        capture_output=True,
        check=False,
    )
    assert ran.returncode == -9
    left = scenarios.keys(robots / "ws")
    scenarios.require_whole_files(robots / "ws")
    for files in scenarios.enclaves(robots / "ws").values():
        assert not files or len(files) == 7
    assert keymint("provision", robots / "policy.xml", "-w", robots / "ws").code == 0
    checked = keymint("check", "-q", "-w", robots / "ws")
    assert (checked.code, checked.err) == (0, "")
    assert not any(".keymint-" in path or path.endswith("running") for path in scenarios.tree(robots / "ws"))
    now = scenarios.keys(robots / "ws")
    assert {name: now[name] for name in left} == left
    assert len(now) == 8 + 2


def test_a_command_interrupted_during_its_imports_reports_it(memory: Path) -> None:
    (memory / "policy.xml").write_text(scenarios.policy("/a"))
    module = re.compile("keymint/commands/.*provision")
    log = memory / "log"
    trace = ["strace", "-f", "-q", "-e", "trace=openat", "-o"]
    subprocess.run([*trace, log, *command(memory)], env=tracing.environment(), capture_output=True, check=True)
    opened = [line for line in log.read_text().splitlines() if "openat(" in line]
    number = next(at for at, line in enumerate(opened, 1) if module.search(line))
    shutil.rmtree(memory / "ws")
    ran = subprocess.run(
        [*trace, os.devnull, "-e", f"inject=openat:signal=SIGINT:when={number}", *command(memory)],
        env=tracing.environment(),
        capture_output=True,
        text=True,
        check=False,
    )
    assert ran.returncode == 130
    assert "interrupted" in one_line(Ended(130, ran.stdout + ran.stderr))
    assert not (memory / "ws").exists()
