# SPDX-License-Identifier: Apache-2.0
"""The index of files: it has the digests of the files that are there, whoever changes them meanwhile."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping
from pathlib import Path

import pytest

from keymint.run.execution import open_store
from keymint.store.changes import File, FolderChange
from keymint.store.store import Store
from keymint.store.workspace_lock import clock
from keymint.view.folder_status import Sight
from keymint.view.stamps import digest
from keymint.view.tree import Tree
from keymint.workspace import file_index
from keymint.workspace.file_index import INDEX
from keymint.workspace.workspace import Workspace


@pytest.fixture
def workspace(tmp_path: Path) -> Workspace:
    """A workspace with a built package."""
    made = Workspace.at(tmp_path / "ws", {}, tmp_path)
    (made.build / "a").mkdir(parents=True)
    (made.build / "a" / "file").write_bytes(b"content")
    (made.build / "a" / "other").write_bytes(b"other")
    return made


def known(workspace: Workspace) -> Mapping[str, str]:
    """Return the digests that the index has of the package."""
    return file_index.load(workspace, Sight.of(map(str, workspace.spaces()))).get(str(workspace.build / "a"), {})


def run(
    workspace: Workspace,
    work: Callable[[Tree, Store], object],
    *changes: FolderChange,
    written: Callable[[], object] = lambda: None,
) -> None:
    """Look at the workspace, work, write changes, and save the index; then something may happen before that."""
    store = open_store(workspace)
    with store.locked(lambda: None):
        sight = Sight.of(map(str, workspace.spaces()), clock(workspace.state))
        tree = Tree(known=file_index.load(workspace, sight))
        work(tree, store)
        staged = store.stage(changes)
        visible = clock(workspace.state)
        store.commit([staged])
        written()
        file_index.save(store, workspace, tree, sight, changes, visible)


def ask(tree: Tree, workspace: Workspace) -> list[str | None]:
    return [tree.digest(workspace.build / "a" / name) for name in ("file", "other", "missing")]


def answers(workspace: Workspace, *expected: str | None) -> Callable[[Tree, Store], None]:
    """Return work that asks for the digests, and expects these."""

    def work(tree: Tree, _: Store) -> None:
        assert ask(tree, workspace) == [*expected]

    return work


def test_a_file_is_read_once_and_again_when_it_changed(workspace: Workspace) -> None:
    expected = [digest(b"content"), digest(b"other"), None]
    for _ in range(2):
        run(workspace, answers(workspace, *expected))
        assert known(workspace) == {"file": digest(b"content"), "other": digest(b"other")}
    (workspace.build / "a" / "file").write_bytes(b"CONTENT")
    assert known(workspace) == {}
    run(workspace, answers(workspace, digest(b"CONTENT"), *expected[1:]))


def test_an_unchanged_file_is_not_read(workspace: Workspace, monkeypatch: pytest.MonkeyPatch) -> None:
    run(workspace, lambda tree, _: ask(tree, workspace))
    tree = Tree(known=file_index.load(workspace, Sight.of(map(str, workspace.spaces()))))
    monkeypatch.setattr("keymint.view.tree.read_file", lambda _: None)
    assert ask(tree, workspace) == [digest(b"content"), digest(b"other"), None]


def test_what_is_written_is_known_without_reading(workspace: Workspace) -> None:
    new = workspace.build / "b" / "c"
    change = FolderChange(new, {"made": File(b"made")})
    run(workspace, lambda tree, _: ask(tree, workspace), change, FolderChange(workspace.build / "a", {}, ("other",)))
    assert known(workspace) == {"file": digest(b"content")}
    assert file_index.load(workspace, Sight.of(map(str, workspace.spaces())))[str(new)] == {"made": digest(b"made")}


def outside(workspace: Workspace, name: str, content: bytes) -> Callable[[Tree, Store], object]:
    """Return work that reads the files before another program writes one of them."""

    def work(tree: Tree, _: Store) -> None:
        ask(tree, workspace)
        (workspace.build / "a" / name).write_bytes(content)

    return work


@pytest.mark.parametrize("name", ["file", "new"])
@pytest.mark.parametrize("folder", ["a", "b"], ids=["beside what is written", "elsewhere"])
def test_what_another_program_changes_meanwhile_is_not_trusted(workspace: Workspace, name: str, folder: str) -> None:
    change = FolderChange(workspace.build / folder, {"made": File(b"made")})
    run(workspace, outside(workspace, name, b"edited!"), change)
    assert known(workspace) == {}


def test_what_another_program_removes_meanwhile_is_not_trusted(workspace: Workspace) -> None:
    def work(tree: Tree, _: Store) -> None:
        ask(tree, workspace)
        (workspace.build / "a" / "file").unlink()

    run(workspace, work, FolderChange(workspace.build / "a", {"made": File(b"made")}))
    assert known(workspace) == {}


def test_a_moved_workspace_keeps_its_index_and_a_copied_one_does_not(workspace: Workspace, tmp_path: Path) -> None:
    run(workspace, lambda tree, _: ask(tree, workspace))
    workspace.root.rename(tmp_path / "moved")
    moved = Workspace.at(tmp_path / "moved", {}, tmp_path)
    assert known(moved) == {"file": digest(b"content"), "other": digest(b"other")}
    shutil.copytree(moved.root, workspace.root)
    assert known(workspace) == {}


@pytest.mark.parametrize("damage", [b"", b"{", b'{"version":1,"folders":{}}\n'])
def test_a_damaged_index_knows_nothing(workspace: Workspace, damage: bytes) -> None:
    run(workspace, lambda tree, _: ask(tree, workspace))
    (workspace.state / INDEX).write_bytes(damage)
    assert known(workspace) == {}


def test_what_another_program_does_to_a_new_file_is_not_trusted(workspace: Workspace) -> None:
    new = workspace.build / "b"
    change = FolderChange(new, {"made": File(b"made")})
    run(workspace, lambda *_: None, change, written=lambda: (new / "made").write_bytes(b"MADE"))
    assert str(new) not in file_index.load(workspace, Sight.of(map(str, workspace.spaces())))
