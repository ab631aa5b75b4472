# SPDX-License-Identifier: Apache-2.0
"""The status of a folder: it changes with every file in it, whoever hides the change."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

from keymint.view.recorded_answers import NEVER, Sight, folder_status, walk


def edit_in_place(file: Path) -> None:
    """Change the content, keep size and time of modification."""
    before = file.stat()
    with file.open("r+b") as opened:
        opened.write(b"X")
    os.utime(file, ns=(before.st_atime_ns, before.st_mtime_ns))


def replace_by_link(file: Path) -> None:
    other = file.parent.parent / "elsewhere"
    file.rename(other)
    file.symlink_to(other)


def replace_by_folder(file: Path) -> None:
    file.unlink()
    file.mkdir()


def copy_back(file: Path) -> None:
    """Replace a file by another one with the same content and times."""
    before, content = file.stat(), file.read_bytes()
    (file.parent / "new").write_bytes(content)
    (file.parent / "new").rename(file)
    os.utime(file, ns=(before.st_atime_ns, before.st_mtime_ns))


TOUCHES: dict[str, Callable[[Path], object]] = {
    "edited": edit_in_place,
    "longer": lambda file: file.write_bytes(b"longer content"),
    "mode": lambda file: file.chmod(0o600),
    "mode of the folder": lambda file: file.parent.chmod(0o700),
    "removed": lambda file: file.unlink(),
    "renamed": lambda file: file.rename(file.with_name("other")),
    "link": replace_by_link,
    "folder": replace_by_folder,
    "replaced": copy_back,
    "another file": lambda file: file.with_name("another").write_bytes(b""),
    "linked elsewhere": lambda file: os.link(file, file.parent.parent / "second"),
}


@pytest.mark.parametrize("touch", TOUCHES.values(), ids=TOUCHES)
def test_whatever_becomes_of_a_file_changes_the_status_of_its_folder(
    tmp_path: Path, touch: Callable[[Path], object]
) -> None:
    folder = tmp_path / "folder"
    folder.mkdir(mode=0o755)
    (folder / "file").write_bytes(b"content")
    (folder / "same").write_bytes(b"content")
    before = folder_status(str(folder))
    assert before is not None
    assert before == folder_status(str(folder))
    touch(folder / "file")
    after = folder_status(str(folder))
    assert after is not None
    assert after.digest != before.digest


def test_a_status_is_trusted_if_the_clock_moved_on_since_the_last_change(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"content")
    os.utime(tmp_path / "file", ns=(1, 1))
    status = folder_status(str(tmp_path))
    assert status is not None
    assert status.newest == (tmp_path / "file").stat().st_ctime_ns
    assert not status.is_trusted(status.newest)
    assert status.is_trusted(status.newest + 1)


def test_a_folder_with_a_link_is_never_trusted(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to("nowhere")
    status = folder_status(str(tmp_path))
    assert status is not None
    assert not status.is_trusted(NEVER)


def test_a_file_that_another_program_modified_meanwhile_is_not_trusted(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"content")
    modified = (tmp_path / "file").stat().st_mtime_ns
    for written, since, trusted in (((), modified, False), ((), modified + 1, True), (("file",), modified, True)):
        status = folder_status(str(tmp_path), written, since)
        assert status is not None
        assert status.is_trusted(NEVER) == trusted


def test_all_folders_are_walked_but_those_of_git(tmp_path: Path) -> None:
    for folder in ("a/b", "a/.git/c", "d"):
        (tmp_path / folder).mkdir(parents=True)
    found = walk([str(tmp_path / "a"), str(tmp_path / "d"), str(tmp_path / "missing")])
    assert set(found) == {str(tmp_path / folder) for folder in ("a", "a/b", "d")}


# -- what is there when a run is done --------------------------------------------------------------------------------


@pytest.fixture
def a(tmp_path: Path) -> Path:
    """Return a folder with two files."""
    folder = tmp_path / "ws" / "a"
    folder.mkdir(parents=True)
    for name in ("file", "other"):
        (folder / name).write_bytes(b"content")
    return folder


def now(folder: Path) -> int:
    """Return the clock of the file system, once it has moved on."""
    time.sleep(0.02)
    (folder.parents[1] / "lock").write_bytes(b"")
    time.sleep(0.02)
    return (folder.parents[1] / "lock").stat().st_ctime_ns


def after(
    folder: Path,
    during: Callable[[], object],
    written: str = "",
    late: Callable[[], object] = int,
    made: Sequence[str] = (),
) -> object:
    """Look, let something happen, write a file beside, let something happen, and return what is there then."""
    before = Sight.of([str(folder.parent)], now(folder))
    during()
    if written:
        new = folder.parent / written
        new.parent.mkdir(parents=True, exist_ok=True)
        new.write_bytes(b"made")
    status = {str(folder.parent / each): folder_status(str(folder.parent / each)) for each in made}
    visible = now(folder)
    late()
    names = [(str(new.parent), {new.name}, ())] if written else []
    seen = before.after(names, visible, now(folder), {path: each for path, each in status.items() if each})
    assert seen is None or dict(seen.folders) == walk([str(folder.parent)])
    return seen


@pytest.mark.parametrize("written", ["", "a/made", "b/made"])
def test_what_a_run_leaves_is_what_was_there_and_what_it_wrote(a: Path, written: str) -> None:
    assert after(a, lambda: None, written) is not None


def test_what_a_run_removes_is_gone(a: Path) -> None:
    before = Sight.of([str(a.parent)], now(a))
    (a / "other").unlink()
    moment = now(a)
    seen = before.after([(str(a), (), ("other",))], moment, moment, {})
    assert seen is not None
    assert seen.folders[str(a)].files == ("file",)


@pytest.mark.parametrize(
    "touch",
    [
        lambda folder: (folder / "file").write_bytes(b"CONTENT"),
        lambda folder: (folder / "new").write_bytes(b""),
        lambda folder: (folder / "file").unlink(),
        lambda folder: (folder / "new").mkdir(),
    ],
    ids=["edits", "adds", "removes", "adds a folder"],
)
def test_what_another_program_does_beside_what_a_run_writes_is_in_doubt(
    a: Path, touch: Callable[[Path], object]
) -> None:
    assert after(a, lambda: touch(a), "a/made") is None


def test_what_another_program_does_to_a_new_file_is_in_doubt(a: Path) -> None:
    assert after(a, int, "b/made", lambda: (a.parent / "b/made").write_bytes(b"MADE")) is None


@pytest.mark.parametrize("made", [(), ("b", "b/c")])
@pytest.mark.parametrize(
    ("late", "is_known"),
    [
        (lambda _: None, True),
        (lambda folder: (folder / "new").mkdir(), False),
        (lambda folder: (folder / "new").write_bytes(b""), False),
        (lambda folder: (folder / "c").rename(folder / "new"), False),
    ],
    ids=["nothing", "adds a folder", "adds a file", "renames a folder"],
)
def test_what_another_program_does_in_a_new_folder_of_folders_is_in_doubt(
    a: Path, made: Sequence[str], late: Callable[[Path], object], is_known: bool
) -> None:
    seen = after(a, int, "b/c/made", lambda: late(a.parent / "b"), made)
    assert (seen is not None) == is_known


def test_a_folder_that_is_as_new_as_the_clock_is_in_doubt(a: Path) -> None:
    assert Sight.of([str(a.parent)], 0).after((), 1, 1, {}) is None
