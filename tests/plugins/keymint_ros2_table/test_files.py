# SPDX-License-Identifier: Apache-2.0
"""Files of tables: what is read of them, and when they are refused."""

from __future__ import annotations

import hashlib
import os
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest
from keymint_ros2_table import files, policy_type

from comarmor.errors import ComArmorError
from tests.plugins.keymint_ros2_table.tables import csv_file, database

SELECT = "SELECT '/s', 'ros_topic', 'ros_publish', '/x', 'ALLOW', 0, ''"


def code(path: Path) -> str:
    with pytest.raises(ComArmorError) as error:
        files.read(path)
    return error.value.diagnostics[0].code


def test_the_fingerprint_is_that_of_the_bytes_that_were_read(tmp_path: Path) -> None:
    for path in (csv_file(tmp_path, "/s,ros_topic,ros_publish,/x,ALLOW,,"), database(tmp_path, SELECT)):
        rows, seen = files.read(path)
        assert seen[path] == hashlib.sha256(path.read_bytes()).digest()
        assert {each: policy_type.fingerprint(each) for each in seen} == seen
        assert len(list(rows)) == 1


def test_through_a_link(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(database(tmp_path, SELECT))
    assert len(list(files.read(tmp_path / "link")[0])) == 1


def test_a_transaction_that_is_not_in_the_file_yet(tmp_path: Path) -> None:
    path = database(tmp_path, SELECT, "PRAGMA journal_mode = WAL")
    _, seen = files.read(path)
    with closing(sqlite3.connect(path)) as other:
        other.executescript("CREATE TABLE t (x)")
        assert code(path) == "table-in-use"
        assert any(policy_type.fingerprint(each) != value for each, value in seen.items())
    assert list(files.read(path)[0])


def test_a_transaction_that_may_have_to_be_undone(tmp_path: Path) -> None:
    path = database(tmp_path, SELECT)
    with closing(sqlite3.connect(path, isolation_level=None)) as other:
        other.executescript("PRAGMA journal_mode = PERSIST; PRAGMA cache_size = 1; BEGIN; CREATE TABLE t (x)")
        assert list(files.read(path)[0])  # the file has nothing of it yet
        other.execute("INSERT INTO t WITH n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n LIMIT 9999) SELECT i FROM n")
        assert code(path) == "table-in-use"
        other.execute("COMMIT")
    assert path.with_name("rules.db-journal").stat().st_size
    assert list(files.read(path)[0])


def test_what_is_no_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = csv_file(tmp_path)
    assert code(tmp_path / "missing.csv") == "policy-missing"
    assert code(tmp_path) == "policy-missing"
    monkeypatch.setattr(files, "_MOST_CSV", 10)
    assert code(path) == "table-limit"


def test_what_is_recognised(tmp_path: Path) -> None:
    (tmp_path / "policy.xml").write_text("<profiles/>")
    os.mkfifo(tmp_path / "fifo")
    assert files.recognises(csv_file(tmp_path))
    assert files.recognises(csv_file(tmp_path).rename(tmp_path / "rules"))
    assert files.recognises(csv_file(tmp_path, header="a,b\n"))
    assert files.recognises(database(tmp_path, SELECT))
    assert not any(files.recognises(tmp_path / name) for name in ("policy.xml", "fifo", "missing", "."))
