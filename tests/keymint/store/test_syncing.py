# SPDX-License-Identifier: Apache-2.0
"""A whole file system is synchronised at once only where that is sure to work, and else file by file."""

from __future__ import annotations

import ctypes
import errno
import os
import platform
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from keymint.store import file_writing
from keymint.store.file_writing import FOLDER, sync_file_system, sync_tree


@pytest.fixture
def folder(tmp_path: Path) -> Iterator[int]:
    opened = os.open(tmp_path, FOLDER)
    yield opened
    os.close(opened)


@pytest.fixture
def called(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Return the calls of syncfs, which synchronises nothing."""
    calls: list[int] = []

    def syncfs(opened: int) -> int:
        calls.append(opened)
        return 0

    monkeypatch.setattr(file_writing, "_syncfs", lambda: syncfs)
    return calls


@pytest.mark.parametrize("kind", ["ext4", "xfs", "btrfs", "overlay"])
def test_a_local_file_system_is_synchronised_at_once(
    folder: int, called: list[int], kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(file_writing, "_kind_of", lambda _: kind)
    assert sync_file_system(folder)
    assert called == [folder]


def test_a_file_system_in_memory_needs_no_call(folder: int, called: list[int], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(file_writing, "_kind_of", lambda _: "tmpfs")
    assert sync_file_system(folder)
    assert called == []


@pytest.mark.parametrize("kind", ["nfs4", "cifs", "fuse.sshfs", "9p", "virtiofs", "vboxsf", ""])
def test_a_shared_or_unknown_file_system_is_not(
    folder: int, called: list[int], kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(file_writing, "_kind_of", lambda _: kind)
    assert not sync_file_system(folder)
    assert called == []


@pytest.mark.parametrize(("number", "refused"), [(errno.ENOSYS, True), (errno.EPERM, True), (errno.EIO, False)])
def test_a_refused_call_means_file_by_file_and_an_error_is_an_error(
    folder: int, number: int, refused: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    def failing(_opened: int) -> int:
        ctypes.set_errno(number)
        return -1

    monkeypatch.setattr(file_writing, "_kind_of", lambda _: "ext4")
    monkeypatch.setattr(file_writing, "_syncfs", lambda: failing)
    if refused:
        assert not sync_file_system(folder)
        return
    with pytest.raises(OSError, match="Input/output"):
        sync_file_system(folder)


@pytest.mark.parametrize(
    ("system", "release", "usable"),
    [
        ("Linux", "5.8.0-generic", True),
        ("Linux", "6.18.44", True),
        ("Linux", "5.7.19", False),
        ("Linux", "4.19", False),
        ("Darwin", "23.1.0", False),
        ("Linux", "unknown", False),
    ],
)
def test_a_kernel_that_reports_no_errors_is_not_trusted(
    system: str, release: str, usable: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    uname: Any = os.uname_result((system, "host", release, "version", "machine"))
    monkeypatch.setattr(os, "uname", lambda: uname)
    assert (file_writing._syncfs.__wrapped__() is not None) is usable


def test_the_real_call_on_the_real_file_system(folder: int) -> None:
    if platform.system() != "Linux":
        pytest.skip("syncfs is a call of Linux")
    known = Path("/proc/self/mountinfo").read_text().splitlines()
    identifier = file_writing.mount_of(folder).split()[1]
    [kind] = [line.split(" - ")[1].split()[0] for line in known if line.split()[0] == identifier]
    assert sync_file_system(folder) is (kind in {"tmpfs", *file_writing._LOCAL})


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EACCES, errno.EMFILE])
def test_a_mount_that_cannot_be_asked_about_is_no_other_mount(
    folder: int, number: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(*_: object, **__: object) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(file_writing, "open", refused, raising=False)
    with pytest.raises(OSError, match=os.strerror(number)):
        file_writing.mount_of(folder)


def test_without_proc_a_mount_is_its_device(folder: int, monkeypatch: pytest.MonkeyPatch) -> None:
    def gone(*_: object, **__: object) -> None:
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT))

    monkeypatch.setattr(file_writing, "open", gone, raising=False)
    assert file_writing.mount_of(folder) == str(os.fstat(folder).st_dev)


def test_a_tree_is_synchronised_without_following_links_or_waiting_for_pipes(
    tmp_path: Path, folder: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "a" / "b").mkdir(parents=True)
    (tmp_path / "a" / "b" / "file").touch()
    (tmp_path / "a" / "link").symlink_to(tmp_path / "elsewhere")
    os.mkfifo(tmp_path / "a" / "fifo")
    (tmp_path / "elsewhere").touch()
    synced: list[str] = []
    monkeypatch.setattr(
        os, "fsync", lambda opened: synced.append(str(Path(f"/proc/self/fd/{opened}").readlink().relative_to(tmp_path)))
    )
    sync_tree(folder, "a")
    assert synced == ["a/b/file", "a/b", "a"]
    sync_tree(folder, "elsewhere")
    assert synced[-1] == "elsewhere"
