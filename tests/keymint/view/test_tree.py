# SPDX-License-Identifier: Apache-2.0
"""The read-only view: what lies on the disk, overlaid by what is planned."""

from __future__ import annotations

import os
import socket
from collections.abc import Iterable, Iterator
from pathlib import Path

import pytest
from hypothesis import given, strategies as st

from keymint.errors import KeymintError
from keymint.view.tree import Tree, read_file


def code_of(path: Path) -> str:
    with pytest.raises(KeymintError) as caught:
        read_file(path)
    assert str(caught.value).startswith(str(path))
    return caught.value.diagnostics[0].code


def test_reads_what_is_there_and_none_where_nothing_is(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"content")
    assert read_file(tmp_path / "file") == b"content"
    assert read_file(tmp_path / "other") is None
    assert read_file(tmp_path / "file" / "below") is None


@pytest.mark.parametrize("target", ["file", "missing"])
def test_a_symbolic_link_is_refused_dangling_or_not(tmp_path: Path, target: str) -> None:
    (tmp_path / "file").write_bytes(b"content")
    (tmp_path / "link").symlink_to(target)
    assert code_of(tmp_path / "link") == "symlink-refused"


def test_what_is_no_regular_file_is_refused_without_waiting(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "fifo")  # opening it for reading would wait for a writer
    (tmp_path / "folder").mkdir()
    assert code_of(tmp_path / "fifo") == "file-kind"
    assert code_of(tmp_path / "folder") == "file-kind"
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(tmp_path / "socket"))
        assert code_of(tmp_path / "socket") == "file-unreadable"


def test_an_endless_file_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("keymint.view.file_reading.MAX_FILE", 100)
    (tmp_path / "file").write_bytes(b"x" * 101)
    assert code_of(tmp_path / "file") == "file-size"


def by_folder(planned: Iterable[tuple[Path, bytes | None]]) -> Iterator[tuple[Path, dict[str, bytes | None]]]:
    """Yield planned files as a view is given them, each by itself."""
    yield from ((path.parent, {path.name: content}) for path, content in planned)


def test_the_overlay_hides_the_disk(tmp_path: Path) -> None:
    (tmp_path / "kept").write_bytes(b"old")
    (tmp_path / "changed").write_bytes(b"old")
    (tmp_path / "gone").write_bytes(b"old")
    planned = {tmp_path / "changed": b"new", tmp_path / "gone": None, tmp_path / "a" / "b" / "made": b"new"}
    tree = Tree().overlaid(by_folder(planned.items()))
    assert tree.names(tmp_path) == [("a", True), ("changed", False), ("kept", False)]
    assert tree.names(tmp_path / "a") == [("b", True)]
    assert tree.files(tmp_path) == {"kept": b"old", "changed": b"new"}
    assert tree.files(tmp_path, depth=8) == {"kept": b"old", "changed": b"new", "a/b/made": b"new"}
    assert tree.read(tmp_path / "gone") is None
    assert (tmp_path / "changed").read_bytes() == b"old"


def test_a_later_overlay_hides_an_earlier_one(tmp_path: Path) -> None:
    first = Tree().overlaid([(tmp_path, {"file": b"one", "other": b"one"})])
    second = first.overlaid([(tmp_path, {"file": None})])
    assert second.files(tmp_path) == {"other": b"one"}
    assert first.files(tmp_path) == {"file": b"one", "other": b"one"}


def test_a_link_to_a_folder_is_not_entered(tmp_path: Path) -> None:
    (tmp_path / "real").mkdir()
    (tmp_path / "real" / "file").write_bytes(b"content")
    (tmp_path / "loop").symlink_to(tmp_path)
    assert ("loop", False) in Tree().names(tmp_path)
    with pytest.raises(KeymintError):
        Tree().files(tmp_path, depth=8)  # the link is neither followed nor passed over in silence


def test_files_ends_at_its_depth_and_leaves_out_hidden_folders(tmp_path: Path) -> None:
    for path in ("a.xml", "one/b.xml", "one/two/c.xml", ".git/d.xml", "e.txt"):
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / path).write_bytes(b"")
    assert set(Tree().files(tmp_path, suffix=".xml", depth=2)) == {"a.xml", "one/b.xml"}


PATHS = st.lists(st.sampled_from("abc"), min_size=1, max_size=3).map("/".join)


@given(st.dictionaries(PATHS, st.one_of(st.none(), st.binary(max_size=4)), max_size=8))
def test_the_overlay_alone_is_read_as_a_disk_with_its_files_would_be(planned: dict[str, bytes | None]) -> None:
    root = Path("/nonexistent/overlay")
    files = {path: content for path, content in planned.items() if content is not None}
    if any(other.startswith(f"{path}/") for path in planned for other in planned):
        return  # a path cannot be a file and a folder
    tree = Tree().overlaid(by_folder((root / path, content) for path, content in planned.items()))
    assert tree.files(root, depth=8) == files


@given(st.lists(st.tuples(PATHS, st.one_of(st.none(), st.binary(max_size=4))), max_size=8), st.integers(0, 8))
def test_views_on_top_of_each_other_are_read_as_one_and_leave_each_other_alone(changes, split):
    root = Path("/nonexistent/overlay")
    paths = [path for path, _ in changes]
    if any(other.startswith(f"{path}/") for path in paths for other in paths):
        return  # a path cannot be a file and a folder
    below = Tree().overlaid(by_folder((root / path, content) for path, content in changes[:split]))
    before = below.files(root, depth=8)
    above = below.overlaid(by_folder((root / path, content) for path, content in changes[split:]))
    planned = {path: content for path, content in dict(changes).items() if content is not None}
    assert above.files(root, depth=8) == planned
    assert below.files(root, depth=8) == before


# -- snapshots ---------------------------------------------------------------------------------------------------


def test_what_is_held_is_as_it_was_whatever_becomes_of_it(tmp_path: Path) -> None:
    top = tmp_path / "top"
    (top / "a" / "b").mkdir(parents=True)
    (top / "a" / "b" / "x.xml").write_bytes(b"old")
    (top / "a" / "large.bin").write_bytes(b"old")
    (top / "link").symlink_to("a")
    (top / ".git").mkdir()
    (top / ".git" / "x").write_bytes(b"git")
    (tmp_path / "other").write_bytes(b"other")
    tree = Tree()
    tree.hold(top, suffix=".xml")
    tree.hold(tmp_path / "missing")
    (tmp_path / "missing").mkdir()
    (tmp_path / "missing" / "x").write_bytes(b"late")
    (top / "a" / "b" / "x.xml").write_bytes(b"new")
    (top / "a" / "b" / "late.xml").write_bytes(b"late")
    (top / "late").mkdir()
    assert tree.read(top / "a" / "b" / "x.xml") == b"old"
    assert tree.read(top / "a" / "b" / "late.xml") is None
    assert tree.status(top / "a" / "b" / "late.xml") is None
    assert tree.names(top / "a" / "b") == [("x.xml", False)]
    assert tree.names(top) == [(".git", True), ("a", True), ("link", False)]
    assert tree.names(top / "late" / "deep") == []
    assert tree.read(top / "late" / "deep" / "x") is None
    assert tree.names(tmp_path / "missing") == []
    assert tree.read(tmp_path / "missing" / "x") is None
    assert tree.read(top / ".git" / "x") == b"git"
    assert tree.read(top / "a" / "large.bin") == b"old"
    assert tree.read(tmp_path / "other") == b"other"
    with pytest.raises(KeymintError, match="symbolic link"):
        tree.read(top / "link")


def test_what_cannot_be_held_is_reported_when_it_is_asked_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("keymint.view.file_reading.MAX_FILE", 10)
    (tmp_path / "large.xml").write_bytes(b"x" * 11)
    (tmp_path / "small.xml").write_bytes(b"x")
    tree = Tree()
    tree.hold(tmp_path)
    (tmp_path / "large.xml").unlink()
    assert tree.read(tmp_path / "small.xml") == b"x"
    for _ in range(2):
        with pytest.raises(KeymintError, match="has 11 bytes, 10 are the most"):
            tree.read(tmp_path / "large.xml")


def test_a_held_file_that_becomes_a_link_is_still_a_file(tmp_path: Path) -> None:
    (tmp_path / "public.pem").write_bytes(b"public")
    (tmp_path / "own.pem").write_bytes(b"own")
    tree = Tree(linked=tmp_path)
    tree.hold(tmp_path)
    (tmp_path / "own.pem").unlink()
    (tmp_path / "own.pem").symlink_to("public.pem")
    assert (tree.follows(tmp_path / "own.pem"), tree.read(tmp_path / "own.pem")) == ("", b"own")
    assert Tree(linked=tmp_path).follows(tmp_path / "own.pem") == str(tmp_path / "public.pem")


def test_equal_files_are_held_once(tmp_path: Path) -> None:
    """Enclaves have most of their files in common: a snapshot of a fleet would take twice the memory."""
    for name in ("a.p7s", "b.p7s"):
        (tmp_path / name).write_bytes(b"governance" * 100)
    tree = Tree()
    tree.hold(tmp_path)
    assert tree.read(tmp_path / "a.p7s") is tree.read(tmp_path / "b.p7s")
