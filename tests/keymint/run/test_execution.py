# SPDX-License-Identifier: Apache-2.0
"""A plan is carried out in order, marked while it runs, and recorded when it is done."""

from __future__ import annotations

import os
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest

from keymint.api.plugin_loader import Plugins
from keymint.errors import KeymintError
from keymint.pki.tokens.token_sessions import Tokens
from keymint.run.execution import RECORD, Workers, execute, open_store
from keymint.store.changes import Action, File, FolderChange, Plan, Step
from keymint.store.journal import Journal
from keymint.view.stamps import Stamp, State, load
from keymint.view.tree import Tree
from keymint.workspace.session import Inputs
from keymint.workspace.workspace import Workspace


@pytest.fixture
def workspace(tmp_path: Path) -> Workspace:
    return Workspace.at(tmp_path / "ws", {}, tmp_path)


def step(workspace: Workspace, package: str, stage: str = "build", *, content: bytes = b"x") -> Step:
    change = FolderChange(workspace.build / package, {"document.xml": File(content)})
    return Step(stage, package, Action.CREATED, (change,))


def stamped(*packages: str) -> State:
    return State().updated("build", {name: Stamp("in", {"document.xml": "out"}) for name in packages})


def run(plan: Plan, workspace: Workspace, *, before: State | None = None) -> None:
    execute(
        plan,
        Inputs(
            workspace,
            Tree(),
            before or State(),
            Plugins(()),
            {},
            datetime(2027, 1, 1, tzinfo=UTC),
            lambda: Tokens({}),
        ),
        open_store(workspace),
        Workers(1, lambda: 0.0),
        Journal("keymint build"),
        (),
        (),
        lambda: None,
    )


def everything(workspace: Workspace) -> dict[str, int]:
    files = (path for path in workspace.root.rglob("*") if path.is_file())
    return {str(path.relative_to(workspace.root)): path.stat().st_mtime_ns for path in files}


def test_all_steps_are_carried_out_and_recorded(workspace: Workspace) -> None:
    names = ["a", "a/b", "b", "b/c/d", "e"]
    plan = Plan(tuple(step(workspace, name) for name in names), stamped(*names))
    run(plan, workspace)
    for name in names:
        assert (workspace.build / name / "document.xml").read_bytes() == b"x"
    assert load((workspace.state / RECORD).read_bytes()) == plan.state
    journal = open_store(workspace).recover()
    assert journal is not None  # its caller forgets it after its last write
    assert journal == Journal("keymint build", packages=tuple(names), finished=True)


def test_a_plan_without_changes_writes_not_one_file(workspace: Workspace) -> None:
    plan = Plan((step(workspace, "a"),), stamped("a"))
    run(plan, workspace)
    before = everything(workspace)
    again = Plan((Step("build", "a", Action.UNCHANGED),), plan.state)
    run(again, workspace, before=plan.state)
    assert everything(workspace) == before


def test_a_changed_record_alone_is_written(workspace: Workspace) -> None:
    run(Plan((), stamped("a")), workspace)
    assert load((workspace.state / RECORD).read_bytes()) == stamped("a")


def test_the_steps_become_visible_in_their_order_and_none_before_all_are_staged(
    workspace: Workspace, monkeypatch: pytest.MonkeyPatch
) -> None:
    order: list[str] = []
    rename = os.rename

    def watched(source: str, target: str, **options: Any) -> None:
        if not order:
            assert len(list(workspace.build.glob(".keymint-*"))) == 30
        if target.startswith("p"):
            order.append(target)
        rename(source, target, **options)

    names = [f"p{number}-{stage}" for stage in ("first", "second", "third") for number in range(10)]
    workspace.build.mkdir(parents=True)
    for guarded in (workspace.build, workspace.state):
        guarded.mkdir(exist_ok=True)
        (guarded / ".gitignore").touch()
    store = open_store(workspace)
    store.begin(Journal())
    monkeypatch.setattr(os, "rename", watched)
    store.change(change for name in names for change in step(workspace, name).changes)
    assert order == names


def test_an_outer_package_is_made_with_the_ones_inside_whatever_order_they_were_named_in(
    workspace: Workspace, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[set[str]] = []
    rename = os.rename

    def watched(source: str, target: str, **options: Any) -> None:
        rename(source, target, **options)
        seen.append(
            {path.parent.name for path in workspace.build.rglob("document.xml") if ".keymint-" not in str(path)}
        )

    monkeypatch.setattr(os, "rename", watched)
    steps = tuple(step(workspace, name) for name in ("x/y/z", "b", "x/y", "a", "x"))
    run(Plan(steps, State()), workspace)
    assert [names for at, names in enumerate(seen) if names and names != seen[at - 1]] == [
        {"x", "y", "z"},
        {"x", "y", "z", "b"},
        {"x", "y", "z", "b", "a"},
    ]


def test_a_step_that_fails_ends_the_run_with_its_mark_and_without_its_record(workspace: Workspace) -> None:
    names = ["a", "b", "c"]
    workspace.build.mkdir(parents=True)
    (workspace.build / "b").write_bytes(b"in the way")
    plan = Plan(tuple(step(workspace, name) for name in names), stamped(*names))
    with pytest.raises(KeymintError):
        run(plan, workspace)
    assert not (workspace.state / RECORD).exists()
    journal = open_store(workspace).recover()
    assert journal is not None
    assert not journal.finished  # nothing of it was visible
    assert not (workspace.build / "a").exists()

    (workspace.build / "b").unlink()
    run(plan, workspace)
    assert load((workspace.state / RECORD).read_bytes()) == stamped(*names)


def test_the_record_is_visible_after_all_that_it_describes(
    workspace: Workspace, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And the register, which is what comes first, before all else."""
    order: list[str] = []
    rename = os.rename

    def watched(source: str, target: str, **options: Any) -> None:
        order.append(target)
        rename(source, target, **options)

    register = FolderChange(workspace.private, {"register.sqlite3": File(b"r", secret=True)}, private=True)
    key = FolderChange(workspace.private / "identities" / "a", {"key.pem": File(b"k", secret=True)}, private=True)
    steps = (step(workspace, "b"), Step("build", "a", Action.CREATED, (key,)), step(workspace, "a"))
    workspace.build.mkdir(parents=True)
    monkeypatch.setattr(os, "rename", watched)
    run(Plan(steps, stamped("a", "b"), first=(register,)), workspace)
    assert [each for each in order if each not in {"running", ".gitignore"}] == [
        "register.sqlite3", "identities", "b", "a", RECORD,
    ]  # fmt: skip


def test_files_and_folders_are_removed(workspace: Workspace) -> None:
    run(Plan((step(workspace, "a/b"), step(workspace, "c")), State()), workspace)
    gone = FolderChange(workspace.build / "a" / "b", {}, ("document.xml",))
    run(Plan((Step("build", "a/b", Action.REMOVED, (gone,)),), State()), workspace)
    assert sorted(path.name for path in workspace.build.iterdir() if path.is_dir()) == ["c"]


def test_private_is_private_in_the_store_of_a_workspace(workspace: Workspace) -> None:
    change = FolderChange(workspace.private / "identities" / "a", {"file": File(b"")})
    run(Plan((Step("build", "a", Action.CREATED, (change,)),), State()), workspace)
    folder = workspace.private / "identities" / "a"
    for path in (folder, folder.parent, workspace.private):
        assert path.stat().st_mode & 0o777 == 0o700
    assert workspace.root.stat().st_mode & 0o777 == 0o755
