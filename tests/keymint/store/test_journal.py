# SPDX-License-Identifier: Apache-2.0
"""What a run made visible in part is finished by the next one, and what it did not is dropped."""

from __future__ import annotations

import contextlib
import shutil
from pathlib import Path

import pytest

from keymint.store import group_commit
from keymint.store.changes import File, FolderChange
from keymint.store.journal import Journal, intent_of
from keymint.store.staged import Exchange
from keymint.store.store import Store

OLD = {
    "a": {"x": b"old", "y": b"old", "gone": b"", "same": b"", "own": b"a user's"},
    "b": {"z": b"old", "gone": b"", "too": b""},
    "c": {"z": b"old"},
}
NEW = {"a": {"x": b"new", "y": b"new", "same": b"", "own": b"a user's"}, "b": {"z": b"new"}}


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """Return a workspace with three folders."""
    for name, files in OLD.items():
        store_of(tmp_path).write(tmp_path / "src" / name, {file: File(content) for file, content in files.items()})
    return tmp_path


def store_of(root: Path) -> Store:
    return Store({root: False}, root / ".keymint")


def files_in(folder: Path) -> dict[str, dict[str, bytes]]:
    found: dict[str, dict[str, bytes]] = {}
    for path in (path for path in folder.rglob("*") if path.is_file()):
        found.setdefault(str(path.parent.relative_to(folder)), {})[path.name] = path.read_bytes()
    return found


def stopped(root: Path, monkeypatch: pytest.MonkeyPatch, at: int, *, again: bool = False) -> None:
    """Change the three folders, or finish that, and stop before one of the three names changes."""
    made, calls = group_commit.make_visible, iter(range(100))

    def stopping(folder: int, exchange: Exchange) -> str | None:
        if exchange.folder.endswith("/src") and next(calls) == at:
            raise KeyboardInterrupt
        return made(folder, exchange)

    store = store_of(root)
    with monkeypatch.context() as patch, contextlib.suppress(KeyboardInterrupt):
        patch.setattr(group_commit, "make_visible", stopping)
        if again:
            store.recover()
            return
        store.begin(Journal("keymint build"))
        changes = (
            FolderChange(root / "src/b", {"z": File(b"new")}, ("gone", "too")),
            FolderChange(root / "src/a", {"x": File(b"new"), "y": File(b"new")}, ("gone",)),
            FolderChange(root / "src/c", removed=("z",)),
        )
        store.commit(store.stage(changes))


@pytest.mark.parametrize("at", range(4))
def test_it_is_finished_or_dropped_as_a_whole(root: Path, monkeypatch: pytest.MonkeyPatch, at: int) -> None:
    stopped(root, monkeypatch, at)
    again = store_of(root)
    found = again.recover()
    assert found == Journal("keymint build", finished=at > 0)
    assert files_in(root / "src") == (NEW if at else OLD)
    assert not list(root.rglob(".keymint-*"))
    (root / "src/c").mkdir(exist_ok=True)
    (root / "src/c/z").write_bytes(b"a user's")
    assert again.recover() == found  # until another run begins, or this one ends
    assert (root / "src/c/z").read_bytes() == b"a user's"


@pytest.mark.parametrize("at", range(2))
def test_a_run_that_finishes_it_may_be_stopped_as_well(root: Path, monkeypatch: pytest.MonkeyPatch, at: int) -> None:
    stopped(root, monkeypatch, 1)
    stopped(root, monkeypatch, at, again=True)
    assert store_of(root).recover() == Journal("keymint build", finished=True)
    assert files_in(root / "src") == NEW


def test_what_a_user_changed_meanwhile_is_kept(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stopped(root, monkeypatch, 1)
    for path in ("a/own", "a/deep/added", "c/added"):
        (root / "src" / path).parent.mkdir(exist_ok=True)
        (root / "new").write_bytes(b"edited")
        (root / "new").replace(root / "src" / path)
    store_of(root).recover()
    own = {"a": {**NEW["a"], "own": b"edited"}, "a/deep": {"added": b"edited"}, "c": {"added": b"edited"}}
    assert files_in(root / "src") == {**NEW, **own}


def test_a_workspace_may_be_moved_meanwhile(root: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    stopped(root, monkeypatch, 1)
    moved = root.parent / f"{root.name}-moved"
    root.rename(moved)
    store_of(moved).recover()
    assert files_in(moved / "src") == NEW


def test_what_was_staged_and_is_lost_is_dropped_with_the_rest(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def stopping(folder: int, exchange: Exchange) -> str | None:
        if exchange.name != "running":
            raise KeyboardInterrupt
        return made(folder, exchange)

    store, made = store_of(root), group_commit.make_visible
    store.begin(Journal())
    new = FolderChange(root / "src/new", {"key": File(b"")}), FolderChange(root / "src/b", {"z": File(b"new")})
    staged = store.stage(new)
    monkeypatch.setattr(group_commit, "make_visible", stopping)
    with pytest.raises(KeyboardInterrupt):
        store.commit(staged)
    monkeypatch.undo()
    (new_folder,) = (root / "src").glob(".keymint-*")  # a workspace that shares the folder swept it away
    shutil.rmtree(new_folder)
    (new_file,) = (root / "src/b").glob(".keymint-*")
    new_file.rename(root / "src/b/z")
    found = store_of(root).recover()
    assert found is not None
    assert not found.finished


@pytest.mark.parametrize("content", [b"", b"0123", b"\0" * 10, b"{}", Journal("x").dump(Path())[:-9]])
def test_a_journal_that_cannot_be_read_has_nothing_to_finish(root: Path, content: bytes) -> None:
    store_of(root).write(root / ".keymint", {"running": File(content)})
    assert store_of(root).recover() == Journal()
    assert files_in(root / "src") == OLD


def test_nothing_outside_of_the_workspace_is_changed(root: Path, tmp_path: Path) -> None:
    """The folder of records may come from elsewhere."""
    (tmp_path / "ws").mkdir()
    (tmp_path / "victim").write_bytes(b"")
    (tmp_path / ".keymint-1-1.tmp").write_bytes(b"evil")
    for exchange in (
        Exchange(0, str(tmp_path), "victim", None, file=True),
        Exchange(0, str(tmp_path), "victim", ".keymint-1-1.tmp", file=True),
        Exchange(0, str(tmp_path / "ws"), "../victim", None, file=True),
    ):
        records = tmp_path / "ws/.keymint"
        done = Exchange(0, str(records), "x", ".keymint-1-2.tmp", file=True)  # it looks as if it became visible
        content = Journal(exchanges=(done, exchange)).dump(records)
        store = Store({tmp_path / "ws": False}, records)
        store.write(records, {"running": File(content)})
        with contextlib.suppress(Exception):
            store.recover()
        assert (tmp_path / "victim").read_bytes() == b""


def test_the_intent_is_that_of_the_same_command_with_the_same_files(tmp_path: Path) -> None:
    def inputs(*words: str) -> str:
        return intent_of(words, tmp_path).inputs

    (tmp_path / "policy.xml").write_text("one")
    (tmp_path / "out").write_text("one")
    (tmp_path / "ks").mkdir()
    command = ("sign", "policy.xml", "ks", "-o", "out")
    first = inputs(*command)
    (tmp_path / "out").write_text("what the command wrote")
    assert inputs(*command, "--json") == inputs("-v", *command) == first
    assert inputs("sign", str(tmp_path / "policy.xml"), "ks", "-o", "out") == first
    assert inputs(*command, "--no-prove") != first
    (tmp_path / "ks/cert.pem").write_text("")
    second = inputs(*command)
    (tmp_path / "policy.xml").write_text("two")
    assert len({first, second, inputs(*command)}) == 3
    assert intent_of(("sign", "a b", "-q"), tmp_path).command == "keymint sign 'a b'"
