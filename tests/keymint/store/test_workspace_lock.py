# SPDX-License-Identifier: Apache-2.0
"""Readers share the workspace lock, and wait for a writer; without a lock they read."""

from __future__ import annotations

import errno
import fcntl
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from keymint.store.store import LOCK, Store, path_lock


def never(_process: str) -> None:
    pytest.fail("waits although nobody writes")


@pytest.fixture
def store(tmp_path: Path) -> Store:
    """Return a store whose lock exists."""
    store = Store({tmp_path: False}, tmp_path / ".keymint")
    with store.locked(never):
        pass
    assert (tmp_path / ".keymint" / LOCK).exists()
    return store


@pytest.mark.usefixtures("store")
def test_readers_do_not_exclude_each_other(tmp_path: Path) -> None:
    with (
        path_lock(tmp_path / ".keymint" / LOCK, fcntl.LOCK_SH, never) as first,
        path_lock(tmp_path / ".keymint" / LOCK, fcntl.LOCK_SH, never) as second,
    ):
        assert first
        assert second


def test_a_reader_waits_for_a_writer(tmp_path: Path, store: Store) -> None:
    order: list[str] = []
    waits = threading.Event()

    def on_wait(_process: str) -> None:
        order.append("waits")
        waits.set()

    def read() -> None:
        with path_lock(tmp_path / ".keymint" / LOCK, fcntl.LOCK_SH, on_wait) as held:
            order.append(f"reads {held}")

    reader = threading.Thread(target=read)
    with store.locked(never):
        reader.start()
        assert waits.wait(10)
        order.append("writer ends")
    reader.join(10)
    assert order == ["waits", "writer ends", "reads True"]


@pytest.mark.parametrize("is_stopped", [False, True])
def test_who_waits_is_told_for_which_process(tmp_path: Path, store: Store, *, is_stopped: bool) -> None:
    told: list[str] = []
    lock = tmp_path / ".keymint" / LOCK
    words = f"import fcntl, sys; f = open({str(lock)!r}); fcntl.flock(f, fcntl.LOCK_EX); print(flush=True); input()"
    with subprocess.Popen([sys.executable, "-c", words], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as holder:
        assert holder.stdin is not None
        assert holder.stdout is not None
        holder.stdout.readline()
        if is_stopped:
            holder.send_signal(signal.SIGSTOP)
            os.waitpid(holder.pid, os.WUNTRACED)

        def let_go(process: str) -> None:
            told.append(process)
            holder.send_signal(signal.SIGCONT)
            holder.stdin.close()

        with store.locked(let_go):
            pass
    more = f", which is stopped: 'kill -CONT {holder.pid}' lets it go on" if is_stopped else ""
    assert told == [f" (process {holder.pid}{more})"]


def test_a_writer_waits_for_a_reader(tmp_path: Path, store: Store) -> None:
    waits = threading.Event()

    def write() -> None:
        with store.locked(lambda _: waits.set()):
            pass

    writer = threading.Thread(target=write)
    with path_lock(tmp_path / ".keymint" / LOCK, fcntl.LOCK_SH, never):
        writer.start()
        assert waits.wait(10)
    writer.join(10)
    assert not writer.is_alive()


@pytest.mark.parametrize("kind", ["nothing", "link"])
def test_without_a_lock_the_workspace_is_read(tmp_path: Path, kind: str) -> None:
    if kind == "link":
        (tmp_path / "elsewhere").touch()
        (tmp_path / LOCK).symlink_to("elsewhere")
    with path_lock(tmp_path / LOCK, fcntl.LOCK_SH, never) as held:
        assert not held
    assert (tmp_path / LOCK).is_symlink() is (kind == "link")


@pytest.mark.usefixtures("store")
def test_the_lock_is_released_after_an_error(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="inside"), path_lock(tmp_path / ".keymint" / LOCK, fcntl.LOCK_SH, never):
        raise ValueError("inside")
    with Store({tmp_path: False}, tmp_path / ".keymint").locked(never):
        pass


def test_a_folder_is_locked_without_a_file_in_it(tmp_path: Path) -> None:
    order: list[str] = []
    waits = threading.Event()

    def write() -> None:
        with path_lock(tmp_path, fcntl.LOCK_EX, lambda _: waits.set()) as held:
            order.append(f"writes {held}")

    writer = threading.Thread(target=write)
    with path_lock(tmp_path, fcntl.LOCK_SH, never) as first, path_lock(tmp_path, fcntl.LOCK_SH, never) as second:
        writer.start()
        assert waits.wait(10)
        order.append(f"read {first} {second}")
    writer.join(10)
    assert order == ["read True True", "writes True"]
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("kind", ["nothing", "link", "no locks"])
def test_what_cannot_be_locked_is_not(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str) -> None:
    folder = tmp_path / "private"
    if kind == "link":
        folder.symlink_to(tmp_path)
    if kind == "no locks":
        folder.mkdir()

        def refuse(*_arguments: object) -> None:
            raise OSError(errno.EBADF, "NFS locks no folder for writing")

        monkeypatch.setattr(fcntl, "flock", refuse)
    with path_lock(folder, fcntl.LOCK_EX, never) as held:
        assert not held


def test_a_failure_to_lock_matters_to_a_writer_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_arguments: object) -> None:
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(fcntl, "flock", fail)
    with path_lock(tmp_path, fcntl.LOCK_SH, never) as held:
        assert not held
    with pytest.raises(OSError, match="Input/output error"), path_lock(tmp_path, fcntl.LOCK_EX, never):
        pass
