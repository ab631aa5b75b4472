# SPDX-License-Identifier: Apache-2.0
"""Planned changes: what differs, and what the next stage sees."""

from __future__ import annotations

from pathlib import Path

from keymint.store.changes import Action, File, FolderChange, Plan, Step, folder_changes
from keymint.view.stamps import State
from keymint.view.tree import Tree


def test_only_files_that_differ_are_written(tmp_path: Path) -> None:
    (tmp_path / "same").write_bytes(b"1")
    (tmp_path / "other").write_bytes(b"1")
    files = {name: File(content) for name, content in (("same", b"1"), ("other", b"2"), ("new", b""))}
    (change,) = folder_changes(Tree(), tmp_path, files)
    assert (change.folder, list(change.files), change.removed) == (tmp_path, ["other", "new"], ())
    assert folder_changes(Tree(), tmp_path, {"same": File(b"1")}) == ()
    planned = Tree().overlaid([(tmp_path, {"other": b"2", "new": b""})])
    assert folder_changes(planned, tmp_path, files) == ()


def test_a_later_change_of_a_plan_replaces_an_earlier_one(tmp_path: Path) -> None:
    (tmp_path / "gone").write_bytes(b"old")
    first = Step("create", "a", Action.CREATED, (FolderChange(tmp_path, {"x": File(b"1"), "y": File(b"1")}),))
    second = Step("build", "a", Action.UPDATED, (FolderChange(tmp_path, {"x": File(b"2")}, ("y", "gone")),))
    tree = Tree().overlaid(Plan((first,), State()).then(Plan((second,), State())).overlay())
    assert [tree.read(tmp_path / name) for name in ("x", "y", "gone")] == [b"2", None, None]


def test_a_plan_writes_if_any_step_changes_a_file(tmp_path: Path) -> None:
    idle = Step("build", "a", Action.KEPT, (FolderChange(tmp_path),))
    removing = Step("build", "b", Action.REMOVED, (FolderChange(tmp_path, removed=("x",)),))
    assert not Plan((idle,), State()).writes()
    assert Plan((idle, removing), State()).writes()
    assert Plan((idle, removing), State()).of_action(Action.KEPT) == {"a"}


def test_a_secret_is_not_shown() -> None:
    assert "hunter2" not in repr(FolderChange(Path("/x"), {"key.pem": File(b"hunter2", secret=True)}))
