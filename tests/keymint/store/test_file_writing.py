# SPDX-License-Identifier: Apache-2.0
"""One file or folder is created with its mode, and errors of the system name their place."""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Iterator
from pathlib import Path

import pytest

from keymint.errors import KeymintError
from keymint.store.changes import File
from keymint.store.file_writing import (
    FOLDER,
    check_component,
    create,
    make_folder,
    reported,
    require_regular,
    temporary,
)
from keymint.store.group_commit import waiting_name
from keymint.view.file_reading import is_temporary


@pytest.fixture
def folder(tmp_path: Path) -> Iterator[int]:
    """Return the open folder of the test."""
    opened = os.open(tmp_path, FOLDER)
    yield opened
    os.close(opened)


def code_of(error: pytest.ExceptionInfo[KeymintError]) -> str:
    return error.value.diagnostics[0].code


@pytest.mark.parametrize("mask", [0o000, 0o022, 0o777])
@pytest.mark.parametrize(("secret", "mode"), [(True, 0o600), (False, 0o644)])
def test_a_file_has_its_mode_whatever_the_umask(
    folder: int, tmp_path: Path, mask: int, secret: bool, mode: int
) -> None:
    before = os.umask(mask)
    try:
        create(folder, tmp_path, "file", File(b"x" * 100_000, secret))
        make_folder("inner", 0o750, folder)
    finally:
        os.umask(before)
    assert (tmp_path / "file").read_bytes() == b"x" * 100_000
    assert stat.S_IMODE((tmp_path / "file").stat().st_mode) == mode
    assert stat.S_IMODE((tmp_path / "inner").stat().st_mode) == 0o750


@pytest.mark.parametrize("kind", ["file", "link"])
def test_nothing_that_exists_is_written_into(folder: int, tmp_path: Path, kind: str) -> None:
    (tmp_path / "other").write_bytes(b"old")
    name = "other" if kind == "file" else "link"
    if kind == "link":
        (tmp_path / "link").symlink_to("other")
    with pytest.raises(KeymintError, match="File exists") as caught:
        create(folder, tmp_path, name, File(b"new"))
    assert str(caught.value).startswith(f"{tmp_path}/{name}: ")
    assert (tmp_path / "other").read_bytes() == b"old"


def test_temporary_names_are_unique_and_recognised() -> None:
    names = {temporary() for _ in range(100)}
    assert len(names) == 100
    assert all(map(is_temporary, names))
    assert not is_temporary(waiting_name(temporary()))
    assert not any(map(is_temporary, (".keymint", ".keymint-notes", "x.tmp", "keymint-1-1.tmp")))


@pytest.mark.parametrize("name", ["", ".", "..", "a/b", "/a", "a\0", "x" * 256, "é" * 128])
def test_text_that_is_no_file_name_is_refused(name: str) -> None:
    with pytest.raises(KeymintError) as caught:
        check_component(name, Path("/ws"))
    assert code_of(caught) == "confined"
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["...", "a b", "-", "x" * 255, "é" * 127])
def test_file_names(name: str) -> None:
    check_component(name, Path("/ws"))


def test_only_a_regular_file_is_replaced(folder: int, tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"123")
    (tmp_path / "link").symlink_to("file")
    (tmp_path / "folder").mkdir()
    os.mkfifo(tmp_path / "pipe")
    status = require_regular(folder, tmp_path, "file")
    assert status is not None
    assert status.st_size == 3
    assert require_regular(folder, tmp_path, "none") is None
    for name, kind in (("link", "a symbolic link"), ("folder", "not a regular file"), ("pipe", "not a regular file")):
        with pytest.raises(KeymintError, match=f"is {kind}") as caught:
            require_regular(folder, tmp_path, name)
        assert code_of(caught) == "symlink-refused"


@pytest.mark.parametrize(
    ("number", "advice"),
    [
        (errno.ENOSPC, "the previous files are intact"),
        (errno.EDQUOT, "the previous files are intact"),
        (errno.EACCES, "owner and mode"),
        (errno.EROFS, "read-only"),
        (errno.EIO, ""),
    ],
)
def test_an_error_of_the_system_is_reported_with_its_place_and_advice(number: int, advice: str) -> None:
    with pytest.raises(KeymintError) as caught, reported(Path("/ws/file")):
        raise OSError(number, "whatever")
    (diagnostic,) = caught.value.diagnostics
    assert (diagnostic.code, str(diagnostic.where)) == ("write-failed", "/ws/file")
    assert diagnostic.message == f"cannot be written: {os.strerror(number)}"
    assert advice in diagnostic.help
    assert bool(diagnostic.help) is bool(advice)


def test_a_link_in_the_way_is_named_as_the_cause(tmp_path: Path) -> None:
    (tmp_path / "real").mkdir()
    (tmp_path / "link").symlink_to("real")
    for path in (tmp_path / "link", tmp_path / "link" / "inner"):
        with pytest.raises(KeymintError, match="symbolic link is in the way") as caught, reported(path):
            os.open(tmp_path / "link", FOLDER)
        assert code_of(caught) == "symlink-refused"


def test_an_error_that_is_reported_already_passes(tmp_path: Path) -> None:
    with pytest.raises(KeymintError, match=r"^mine$"), reported(tmp_path):
        raise KeymintError("mine")
