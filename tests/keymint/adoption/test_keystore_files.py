# SPDX-License-Identifier: Apache-2.0
"""Keystores are read with limits, and no link is followed out of them."""

from __future__ import annotations

import os
from datetime import UTC, datetime
from pathlib import Path

import pytest

from keymint.adoption import keystore_files
from keymint.adoption.keystore_files import read_keystore
from keymint.errors import KeymintError

NOW = datetime(2026, 1, 1, tzinfo=UTC)


def test_files_and_links_within(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "a/b").write_text("content")
    (tmp_path / "a/b").chmod(0o640)
    (tmp_path / "c").symlink_to("a/b")
    files, problems = read_keystore(tmp_path, "ks", NOW)
    assert not problems
    assert [(path, each.link, each.mode, each.content) for path, each in files.files.items()] == [
        ("a/b", "", 0o640, b"content"), ("c", "a/b", 0o640, b"content"),
    ]  # fmt: skip
    assert "content" not in repr(files)


def test_what_is_refused_is_an_error_at_its_place(tmp_path: Path) -> None:
    root = tmp_path / "ks"
    (root / "folder").mkdir(parents=True)
    (tmp_path / "outside").write_text("secret")
    (root / "absolute").symlink_to(root / "folder")
    (root / "loop").symlink_to("loop")
    (root / "out").symlink_to("../outside")
    (root / "way").symlink_to("out")
    (root / "directory").symlink_to("folder")
    os.mkfifo(root / "pipe")
    files, problems = read_keystore(root, "ks", NOW)
    assert not files.files
    assert [str(each.where) for each in problems] == [
        "ks/absolute", "ks/directory", "ks/loop", "ks/out", "ks/pipe", "ks/way",
    ]  # fmt: skip
    assert {each.code for each in problems} == {"keystore-link", "file-kind"}


def test_limits(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in "abc":
        (tmp_path / name).write_text("12345")
    monkeypatch.setattr(keystore_files, "MAX_FILE", 4)
    _, problems = read_keystore(tmp_path, "ks", NOW)
    assert [each.code for each in problems] == ["file-size"] * 3
    monkeypatch.setattr(keystore_files, "MAX_FILE", 5)
    monkeypatch.setattr(keystore_files, "MOST_FILES", 2)
    with pytest.raises(KeymintError, match="more than 2 files"):
        read_keystore(tmp_path, "ks", NOW)
