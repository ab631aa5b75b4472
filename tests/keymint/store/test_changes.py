# SPDX-License-Identifier: Apache-2.0
"""Planned changes: what differs, and what the next stage sees."""

from __future__ import annotations

from pathlib import Path

import pytest

from keymint.store.changes import Action, File, FolderChange, HeldChanges, Plan, Step, folder_changes
from keymint.view.stamps import Stamp, State, digest
from keymint.view.tree import HeldError, Tree


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


def held(src: Path, keys: Path, name: str) -> Plan:
    """Return the plan of a package whose files another process holds; its stamp does not have the key."""
    stamp = Stamp("", {"a.xml": digest(name), "b.xml": "2" * 64}, ("b.xml",)).row
    places = (f"{src}/", ("a.xml", "b.xml"), False), (f"{keys}/", ("key.pem",), True)
    return Plan((Step("create", name, Action.CREATED, HeldChanges(name, places, stamp)),), State())


def test_what_another_process_holds_is_seen_but_not_read(tmp_path: Path) -> None:
    src, keys = tmp_path / "src", tmp_path / "keys"
    (src / "r0").mkdir(parents=True)
    plan = held(src, keys, "r0/talker").then(held(src, keys, "r0/camera")).then(held(src, keys, "r1"))
    names = ("r0/talker", "r0/camera", "r1")
    assert plan.writes()
    assert not [*plan.changes()]
    assert [folder for folder, _, _ in plan.names()] == [f"{space}/{name}" for name in names for space in (src, keys)]
    assert [[*written] for _, written, _ in plan.names()] == [["a.xml", "b.xml"], ["key.pem"]] * 3
    tree = Tree().overlaid(plan.overlay(), plan.held())
    assert [tree.digest(src / name / "a.xml") for name in names] == [digest(name) for name in names]
    assert tree.names(tmp_path) == [("keys", True), ("src", True)]
    assert tree.names(src) == [("r0", True), ("r1", True)]
    assert tree.names(src / "r0") == [("camera", True), ("talker", True)]
    assert tree.names(src / "r1") == [("a.xml", False), ("b.xml", False)]
    assert tree.has_file(keys / "r1/key.pem")
    assert not tree.has_file(keys / "r1/a.xml")
    for question in (tree.read, tree.digest):
        with pytest.raises(HeldError):
            question(keys / "r1/key.pem")


def test_a_later_plan_changes_what_another_process_holds(tmp_path: Path) -> None:
    src, keys = tmp_path / "src", tmp_path / "keys"
    first = held(src, keys, "r0/talker")
    tree = Tree().overlaid(first.overlay(), first.held())
    change = FolderChange(src / "r0/talker", {"c.xml": File(b"")}, ("a.xml",))
    later = Plan((Step("build", "r0/talker", Action.UPDATED, (change,)),), State()).then(held(src, keys, "r0/camera"))
    after = tree.overlaid(later.overlay(), later.held())
    assert after.names(src / "r0/talker") == [("b.xml", False), ("c.xml", False)]
    assert after.names(src / "r0") == [("camera", True), ("talker", True)]
    assert tree.names(src / "r0") == [("talker", True)]
    with pytest.raises(HeldError):
        after.overlaid((), first.held())


def test_a_plan_that_is_carried_out_keeps_what_is_reported(tmp_path: Path) -> None:
    content = File(lambda: (b"x",))
    whole = Plan((), State().updated("policy", {"a": Stamp("", {})}), (), (FolderChange(tmp_path, {"r": content}),))
    plan = whole.then(held(tmp_path, tmp_path / "keys", "r0")).carried_out("policy")
    assert [(folder, [*written]) for folder, written, _ in plan.names()] == [
        (str(tmp_path), ["r"]), (f"{tmp_path}/r0", ["a.xml", "b.xml"]), (f"{tmp_path}/keys/r0", ["key.pem"]),
    ]  # fmt: skip
    assert not any(each.files for each in plan.changes())


def test_content_that_is_made_late_is_that_of_the_file(tmp_path: Path) -> None:
    file = File(lambda: (b"a", b"", b"b"))
    assert (file.content, file.digest) == (b"ab", digest(b"ab"))
    assert Tree().overlaid([(tmp_path, {"x": file})]).read(tmp_path / "x") == b"ab"
