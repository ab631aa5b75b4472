"""A run that is struck at any system call: what it leaves is whole, and a later run ends what it began.

Every call that may change the workspace is struck in turn when ``KEYMINT_EVERY_CALL=1``, else a part of them.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from . import scenarios, tracing
from .scenarios import PROVISION, SCENARIOS, Scenario
from .tracing import Ended, Point, Trace

pytestmark = pytest.mark.strace

Keymint = Callable[..., Any]
CRITICAL = frozenset({"renameat", "rmdir", "unlink"})
"""The calls around which what is visible changes."""
IN_ORDER = 20
"""How many of the calls of one kind are struck, evenly spread over the run."""


@pytest.fixture(scope="module", autouse=True)
def strace() -> None:
    tracing.require_strace()


@pytest.fixture
def memory(tmp_path: Path) -> Iterator[Path]:
    """Return a folder that is in memory where the machine has such: hundreds of runs synchronise their files."""
    shared = Path("/dev/shm")
    if not os.access(shared, os.W_OK):
        yield tmp_path
        return
    with tempfile.TemporaryDirectory(dir=shared) as folder:
        yield Path(folder)


@dataclass(frozen=True)
class Prepared:
    """A scenario that was run without a disturbance, and the state that the disturbed ones begin with."""

    scenario: Scenario
    start: Path
    traced: Trace
    tree: Mapping[str, str]
    before: Mapping[str, set[str]]
    after: Mapping[str, set[str]]

    def copy(self, to: Path) -> Path:
        """Make a copy of the state that the run begins with; a workspace knows its own name, but not its place."""
        shutil.copytree(self.start, to)
        return to


def prepare(name: str, folder: Path, keymint: Keymint) -> Prepared:
    scenario = SCENARIOS[name]
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
        scenarios.enclaves(start / "ws"),
        scenarios.enclaves(undisturbed / "ws"),
    )


def chosen(points: Sequence[Point], most: int = IN_ORDER) -> list[Point]:
    """Return the points to strike at: of each kind of call, some from the whole course of the run."""
    if os.environ.get("KEYMINT_EVERY_CALL") == "1":
        return list(points)
    kept: list[Point] = []
    for call in sorted({point.call for point in points}):
        of_kind = [point for point in points if point.call == call]
        limit = most if call in CRITICAL else most // 4
        step = max(1, -(-len(of_kind) // limit))
        kept += [*of_kind[::step], of_kind[-1]]
    return sorted(set(kept), key=points.index)


def require_convergence(prepared: Prepared, folder: Path, keymint: Keymint) -> None:
    """Require that the run, made once more, ends what the disturbed one began."""
    workspace = folder / "ws"
    minted = scenarios.keys(workspace)
    again = keymint(*prepared.scenario.arguments(folder))
    assert again.code == 0, again.err
    assert scenarios.tree(workspace) == prepared.tree
    if "--renew" not in prepared.scenario.verb:
        now = scenarios.keys(workspace)
        assert {name: now.get(name) for name in minted} == minted
    checked = keymint("check", "-w", workspace)
    assert (checked.code, checked.err) == (0, "")
    scenarios.require_whole_files(workspace)


def disturb(
    prepared: Prepared,
    how: str,
    points: Sequence[Point],
    folder: Path,
    keymint: Keymint,
    require: Callable[[Ended, Point], None],
) -> None:
    """Strike copies of a run, each at a point of its own, and look at each as it was left and after another run."""
    assert points
    copies = [prepared.copy(folder / f"{how}-{at}") for at in range(len(points))]
    print(how, len(points), len(prepared.traced.points))
    struck = [(point, prepared.scenario.arguments(copy)) for point, copy in zip(points, copies, strict=True)]
    for (point, _), copy, ended in zip(struck, copies, tracing.strike(how, struck, prepared.traced, folder), strict=True):
        try:
            require(ended, point)
            scenarios.require_whole_files(copy / "ws")
            scenarios.require_whole_enclaves(copy / "ws", prepared.before, prepared.after)
            require_convergence(prepared, copy, keymint)
        except Exception as error:
            error.add_note(f"struck at {point}\n{ended.output}")
            raise
        shutil.rmtree(copy)


@pytest.mark.parametrize("name", SCENARIOS)
def test_killed_at_any_call_a_run_converges(name: str, memory: Path, keymint: Keymint) -> None:
    prepared = prepare(name, memory, keymint)

    def killed(ended: Ended, _point: Point) -> None:
        assert ended.code == -9

    disturb(prepared, "signal=SIGKILL", chosen(prepared.traced.points), memory, keymint, killed)
