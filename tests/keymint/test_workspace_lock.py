# SPDX-License-Identifier: Apache-2.0
"""Readers share the workspace lock, and wait for a writer; without a lock they read."""

from __future__ import annotations

import threading
from pathlib import Path

import pytest

from keymint.store import Store
from keymint.workspace_lock import LOCK, read_lock


def never() -> None:
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
    with read_lock(tmp_path / ".keymint", never) as first, read_lock(tmp_path / ".keymint", never) as second:
        assert first
        assert second


def test_a_reader_waits_for_a_writer(tmp_path: Path, store: Store) -> None:
    order: list[str] = []
    waits = threading.Event()

    def on_wait() -> None:
        order.append("waits")
        waits.set()

    def read() -> None:
        with read_lock(tmp_path / ".keymint", on_wait) as held:
            order.append(f"reads {held}")

    reader = threading.Thread(target=read)
    with store.locked(never):
        reader.start()
        assert waits.wait(10)
        order.append("writer ends")
    reader.join(10)
    assert order == ["waits", "writer ends", "reads True"]


def test_a_writer_waits_for_a_reader(tmp_path: Path, store: Store) -> None:
    waits = threading.Event()

    def write() -> None:
        with store.locked(waits.set):
            pass

    writer = threading.Thread(target=write)
    with read_lock(tmp_path / ".keymint", never):
        writer.start()
        assert waits.wait(10)
    writer.join(10)
    assert not writer.is_alive()


@pytest.mark.parametrize("kind", ["nothing", "link"])
def test_without_a_lock_the_workspace_is_read(tmp_path: Path, kind: str) -> None:
    if kind == "link":
        (tmp_path / "elsewhere").touch()
        (tmp_path / LOCK).symlink_to("elsewhere")
    with read_lock(tmp_path, never) as held:
        assert not held
    assert (tmp_path / LOCK).is_symlink() is (kind == "link")


@pytest.mark.usefixtures("store")
def test_the_lock_is_released_after_an_error(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="inside"), read_lock(tmp_path / ".keymint", never):
        raise ValueError("inside")
    with Store({tmp_path: False}, tmp_path / ".keymint").locked(never):
        pass
