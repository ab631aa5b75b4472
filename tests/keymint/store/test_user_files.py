# SPDX-License-Identifier: Apache-2.0
"""Files of the user: complete or as they were, and nothing is left beside them."""

from __future__ import annotations

import fcntl
import os
import threading
from pathlib import Path
from typing import Any

import pytest

from keymint.errors import KeymintError
from keymint.store.changes import File
from keymint.store.user_files import write_files

PART = ".key.pem.keymint-part"
SECRET = File(b"secret", secret=True)


def alone(_process: str) -> None:
    pytest.fail("waits for nobody")


def mode(path: Path) -> int:
    return path.stat().st_mode & 0o777


def test_a_file_is_secret_from_its_first_byte_and_nothing_is_left(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write, seen = os.write, []

    def watched(opened: int, content: bytes) -> int:
        seen.append((sorted(path.name for path in tmp_path.iterdir()), mode(tmp_path / PART)))
        return write(opened, content)

    monkeypatch.setattr(os, "write", watched)
    monkeypatch.setattr(os, "umask", lambda _: pytest.fail("the mode is given"))
    write_files(tmp_path, {tmp_path / "key.pem": File(b"public")}, alone)
    assert seen == [([PART], 0o600)]
    assert [(path.name, mode(path)) for path in tmp_path.iterdir()] == [("key.pem", 0o644)]
    write_files(tmp_path, {tmp_path / "key.pem": SECRET, tmp_path / "new/deep/x": File(b"x", mode=0o640)}, alone)
    assert (mode(tmp_path / "key.pem"), mode(tmp_path / "new/deep/x")) == (0o600, 0o640)


@pytest.mark.parametrize("changes", [True, False], ids=["written", "up to date"])
def test_what_a_killed_run_left_is_removed(tmp_path: Path, changes: bool) -> None:
    (tmp_path / PART).write_bytes(b"half a key")
    wanted = {tmp_path / "key.pem": SECRET}
    write_files(tmp_path, wanted if changes else {}, alone, wanted)
    assert [path.name for path in tmp_path.iterdir()] == (["key.pem"] if changes else [])


def test_a_run_waits_for_another_one_that_writes_the_same_file(tmp_path: Path) -> None:
    waits, order = threading.Event(), []
    with (tmp_path / PART).open("wb") as other:
        fcntl.flock(other, fcntl.LOCK_EX)
        thread = threading.Thread(
            target=lambda: (
                write_files(tmp_path, {tmp_path / "key.pem": SECRET}, lambda _: waits.set()),
                order.append("second"),
            )
        )
        thread.start()
        assert waits.wait(10)
        other.write(b"of the first")
        other.flush()
        order.append("first")
        (tmp_path / PART).rename(tmp_path / "key.pem")
    thread.join(10)
    assert order == ["first", "second"]
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == {"key.pem": b"secret"}


@pytest.mark.parametrize("what", ["link", "folder", "part is a link"])
def test_what_is_in_the_way_is_not_touched(tmp_path: Path, what: str) -> None:
    (tmp_path / "victim").write_bytes(b"a user's")
    path = tmp_path / (PART if what == "part is a link" else "key.pem")
    if what == "folder":
        path.mkdir()
    else:
        path.symlink_to(tmp_path / "victim")
    with pytest.raises(KeymintError):
        write_files(tmp_path, {tmp_path / "other": File(b""), tmp_path / "key.pem": SECRET}, alone)
    assert (tmp_path / "victim").read_bytes() == b"a user's"
    assert {each.name for each in tmp_path.iterdir()} == {"victim", path.name}  # nor is any other file written


def test_after_an_error_the_target_is_as_it_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "key.pem").write_bytes(b"before")

    def refused(*_: Any, **__: Any) -> None:
        raise OSError(28, "No space left on device")

    for call in ("write", "fsync", "rename"):
        with monkeypatch.context() as patch:
            patch.setattr(os, call, refused)
            with pytest.raises(KeymintError, match="No space left"):
                write_files(tmp_path, {tmp_path / "key.pem": SECRET}, alone)
        assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == {"key.pem": b"before"}
