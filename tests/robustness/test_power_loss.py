# SPDX-License-Identifier: Apache-2.0
"""After a loss of power nothing old is lost, nothing secret is open, and the next run completes the work.

The model of what a disk may hold is in :mod:`tests.robustness.power_loss`. With ``KEYMINT_FULL=1`` there are thousands
of images, otherwise some hundreds.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from random import Random
from typing import Any

import pytest

from keymint.store import group_commit
from tests.effort import FULL, tries

from . import scenarios
from .power_loss import Crash, Image, Recorder, Recording, crashes, image, write_image
from .scenarios import PROVISION, SCENARIOS, Scenario

Keymint = Callable[..., Any]


WAYS = ("one by one", "whole file system")
CASES = [
    pytest.param(name, way, id=f"{way}-{name}")
    for at, name in enumerate(SCENARIOS)
    for way in (WAYS if FULL else WAYS[at % 2 :][:1])
]
"""Each scenario, synchronised in both ways; the sample has each in one of them, in turn."""


@pytest.fixture
def way(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Synchronise one by one, as for few files, or the whole file system at once."""
    if request.param == "whole file system":
        monkeypatch.setattr(group_commit, "FEW", -1)


@dataclass(frozen=True)
class State:
    """The files of each enclave, and the private keys by path."""

    enclaves: Mapping[str, Mapping[str, bytes]]
    keys: Mapping[str, bytes]

    @staticmethod
    def of(workspace: Path) -> State:
        return State(scenarios.enclaves(workspace), scenarios.keys(workspace))

    @staticmethod
    def on(found: Image) -> State:
        """Return what is visible on a disk image."""
        enclaves: dict[str, dict[str, bytes]] = {}
        keys = {}
        for path, (_, content) in found.items():
            folder, _, name = path.rpartition("/")
            if ".keymint-" in path or content is None:
                continue
            if path.startswith("install/enclaves/"):
                enclaves.setdefault(folder.removeprefix("install/enclaves").lstrip("/") or ".", {})[name] = content
            elif path.startswith("private/") and path.endswith(".pem"):
                keys[path] = content
        return State(enclaves, keys)


def recorded(scenario: Scenario, run: Path, keymint: Keymint) -> tuple[Recording, State, State]:
    """Record a run; return also the states before and after it."""
    run.mkdir()
    (run / "policy.xml").write_text(scenarios.policy("/robot/talker", "/listener"))
    for change in scenario.before:
        change(run)
        assert keymint(*[argument.format(run) for argument in PROVISION]).code == 0
    scenario.change(run)
    (run / "ws").mkdir(exist_ok=True)
    old = State.of(run / "ws")
    with Recorder(run / "ws").patched() as recording:
        ran = keymint(*scenario.arguments(run))
    assert ran.code == 0, ran.err
    return recording, old, State.of(run / "ws")


@pytest.mark.parametrize(("name", "way"), CASES, indirect=["way"])
def test_a_loss_of_power_loses_nothing_and_the_next_run_converges(
    name: str, way: None, memory: Path, keymint: Keymint
) -> None:
    scenario, run = SCENARIOS[name], memory / "run"
    recording, old, new = recorded(scenario, run, keymint)
    tree = scenarios.tree(run / "ws")
    whole = image(recording, Crash(len(recording.events), lambda _: True, bytes))
    assert set(whole) == set(scenarios.tree(run / "ws", answers=True))
    met: set[int] = set()
    for crash in crashes(recording, Random(name), tries(200, 5000)):
        found = image(recording, crash)
        event = recording.events[max(0, crash.at - 1)]
        try:
            require_secrecy(found)
            require_nothing_lost(found, old, new)
            # Images that differ only in what the next run sweeps away are all one to it.
            swept = hash(frozenset((path, *of) for path, of in found.items() if ".keymint-" not in path))
            if swept not in met and len(met) < tries(5, 300):
                met.add(swept)
                folder = memory / f"image{len(met)}"
                folder.mkdir()
                shutil.copy(run / "policy.xml", folder)
                write_image(found, folder / "ws")
                require_convergence(scenario, folder, tree, keymint)
                if scenarios.KEYS_MOVE & set(scenario.verb):
                    assert State.of(folder / "ws").keys == new.keys
                shutil.rmtree(folder)
        except Exception as error:
            error.add_note(f"power was lost after {crash.at} of {len(recording.events)} calls: {event}")
            error.add_note("\n".join(f"{mode:o} {path}" for path, (mode, _) in sorted(found.items())))
            raise


def require_convergence(scenario: Scenario, folder: Path, tree: Mapping[str, str], keymint: Keymint) -> None:
    """Check that ``check`` fails in no other way than with its findings, and that the next run completes the work."""
    checked = keymint("check", "-w", folder / "ws")
    assert "Traceback" not in checked.err
    if checked.code == 0:
        scenarios.require_whole_files(folder / "ws")
    again = keymint(*scenario.arguments(folder))
    assert again.code == 0, again.err
    assert scenarios.tree(folder / "ws") == tree
    checked = keymint("check", "-q", *scenarios.unproven(scenario), "-w", folder / "ws")
    assert (checked.code, checked.err) == (0, "")
    scenarios.require_whole_files(folder / "ws")
    scenarios.require_whole_enclaves(folder / "ws", {}, scenarios.enclaves(folder / "ws"))


def require_secrecy(found: Image) -> None:
    """Check that no other user can read a private key, and that no folder around one is open."""
    for path, (mode, content) in found.items():
        if content is not None and b"PRIVATE KEY" in content:
            assert mode == 0o600, path
            assert found[path.rpartition("/")[0]][0] == 0o700, path


def require_nothing_lost(found: Image, old: State, new: State) -> bool:
    """Check that every enclave and every key is there, as it was or as it will be."""
    state = State.on(found)
    for name in {*old.enclaves, *new.enclaves, *state.enclaves}:
        files = state.enclaves.get(name, {})
        assert files in (old.enclaves.get(name, {}), new.enclaves.get(name, {})), name
    for name in {*old.keys, *state.keys}:
        assert state.keys.get(name) in (old.keys.get(name), new.keys.get(name)), name
    return True


def test_the_model_finds_the_mistakes_of_a_run_that_synchronises_too_little(
    memory: Path, keymint: Keymint, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(group_commit, "_sync", lambda *_, **__: None)
    recording, old, new = recorded(SCENARIOS["update"], memory / "run", keymint)
    images = [image(recording, crash) for crash in crashes(recording, Random(1), 2000)]
    with pytest.raises(AssertionError):
        all(require_nothing_lost(found, old, new) for found in images)
