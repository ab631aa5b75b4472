# SPDX-License-Identifier: Apache-2.0
"""Rows of SQLite databases, whose views are code of others."""

from __future__ import annotations

import sqlite3
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest
from keymint_ros2_table import files
from keymint_ros2_table.rows import TableRow

from comarmor.errors import ComArmorError
from tests.plugins.keymint_ros2_table.tables import database

SELECT = "SELECT '/s', 'ros_topic', 'ros_publish', {}, 'ALLOW', 0, ''"


def rows(path: Path) -> list[TableRow | ComArmorError]:
    return list(files.rows_of_database(path.read_bytes(), "t.db"))


def message(path: Path) -> str:
    with pytest.raises(ComArmorError) as error:
        rows(path)
    return str(error.value.diagnostics[0])


def test_rows_of_a_view(tmp_path: Path) -> None:
    select = "SELECT '/s', 'k', 'p', ' /x ', 'ALLOW', 1, 'a' UNION ALL SELECT '/t', 'k', 'p', '/y', 'DENY', NULL, NULL"
    first, second = rows(database(tmp_path, select))
    assert isinstance(first, TableRow)
    assert isinstance(second, TableRow)
    assert (first.object, first.audit, second.audit) == ("/x", "1", "")
    assert (str(first.where), str(first.origin), str(second.where)) == ("a [t.db]:1", "a [t.db]", "t.db:2")


def test_rows_of_one_source_are_different_places(tmp_path: Path) -> None:
    select = "SELECT '/s', 'k', 'p', value, 'ALLOW', 0, 'a' FROM json_each('[\"/x\", \"/y\"]')"
    first, second = (row for row in rows(database(tmp_path, select)) if isinstance(row, TableRow))
    assert str(first.origin) == str(second.origin)
    assert first.origin.spot != second.origin.spot


def test_a_table_with_columns_in_another_order_and_a_computed_one(tmp_path: Path) -> None:
    path = tmp_path / "t.db"
    with closing(sqlite3.connect(path)) as made:
        made.executescript(
            "CREATE TABLE rule (qualifier TEXT, object TEXT GENERATED ALWAYS AS ('/' || kind), kind TEXT,"
            " permission TEXT, subject TEXT);"
            "INSERT INTO rule (qualifier, kind, permission, subject) VALUES ('DENY', 'k', 'p', '/s')"
        )
    (row,) = rows(path)
    assert isinstance(row, TableRow)
    assert (row.subject, row.kind, row.permission, row.object, row.qualifier) == ("/s", "k", "p", "/k", "DENY")


@pytest.mark.parametrize(
    ("expression", "said"),
    [
        ("random()", "rule uses 'the function random', which is not allowed"),
        ("datetime('now')", "rule uses 'the function datetime', which is not allowed"),
        ("current_timestamp", "rule uses 'the function current_timestamp', which is not allowed"),
        ("load_extension('x')", "the database cannot be read: unsafe use of load_extension()"),
        ("(SELECT name FROM pragma_database_list)", "the database cannot be read: unsafe use of virtual table"),
        ("(SELECT x FROM gone)", "the database cannot be read: no such table: main.gone"),
    ],
)
def test_a_view_may_read_and_compute_alone(tmp_path: Path, expression: str, said: str) -> None:
    assert message(database(tmp_path, SELECT.format(expression))).startswith(f"t.db: {said}")


def test_a_view_must_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(files, "_MOST_CHECKS", 3)
    endless = (
        "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) " + SELECT.format("i") + " FROM n WHERE i < 0"
    )
    assert message(database(tmp_path, endless)).startswith("t.db: rule takes too long to compute")


def test_there_may_be_no_more_rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("keymint_ros2_table.rows.MOST_ROWS", 1)
    assert message(database(tmp_path, f"{SELECT.format(1)} UNION ALL {SELECT.format(2)}")).endswith(
        "rule has more than the 1 rows allowed"
    )


def test_values_of_other_types_are_errors_of_their_rows(tmp_path: Path) -> None:
    values = (
        "'k', NULL, '/x', 'ALLOW', 0, 'a'",
        "'k', 'p', 7, 'ALLOW', 0, ''",
        "'k', 'p', x'00', 'ALLOW', 0, ''",
        "'k', 'p', '/x', 'ALLOW', 0.5, ''",
        "'k', 'p', '/x', 'ALLOW', 0, 1",
    )
    select = " UNION ALL ".join(f"SELECT '/s', {each}" for each in values)
    assert [str(each) for each in rows(database(tmp_path, select))] == [
        "a [t.db]:1: permission is NULL, expected TEXT",
        "t.db:2: object is INTEGER, expected TEXT",
        "t.db:3: object is BLOB, expected TEXT",
        "t.db:4: audit is REAL, expected TEXT",
        "t.db:5: source is INTEGER, expected TEXT",
    ]


def test_a_database_without_the_view(tmp_path: Path) -> None:
    path = tmp_path / "t.db"
    with closing(sqlite3.connect(path)) as made:
        made.execute("CREATE TABLE rules (x)")
    assert message(path) == "t.db: the database has no table or view rule (did you mean 'rules'?)"


@pytest.mark.parametrize("damage", [slice(100, 200), slice(4096, 8192)])
def test_a_damaged_database(tmp_path: Path, damage: slice) -> None:
    made = "CREATE TABLE t (a, b, c, d, e, f, g); INSERT INTO t VALUES (1,2,3,4,5,6,7)"
    path = database(tmp_path, "SELECT * FROM t", made)
    content = bytearray(path.read_bytes())
    content[damage] = b"\xff" * len(content[damage])
    path.write_bytes(content)
    assert "database" in message(path)


def test_a_database_that_was_used_with_a_write_ahead_log(tmp_path: Path) -> None:
    path = database(tmp_path, SELECT.format("'/x'"), "PRAGMA journal_mode = WAL")
    assert path.read_bytes()[18:20] == b"\2\2"
    assert len(rows(path)) == 1


@pytest.mark.parametrize("queried", ["{} FROM n ORDER BY 4", "* FROM ({0} FROM n) UNION {0} FROM n"])
def test_a_view_may_not_take_all_memory(tmp_path: Path, queried: str) -> None:
    """In a process of its own, because it is about the memory of a process."""
    endless = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n)"
    select = SELECT.format("hex(zeroblob(1000)) || i")
    path = database(tmp_path, f"{endless} {queried.replace('*', 'SELECT *').format(select)}")
    code = (
        "import sys; from pathlib import Path; from keymint_ros2_table import files as rows\n"
        "try:\n    list(rows.rows_of_database(Path(sys.argv[1]).read_bytes(), 't.db'))\n"
        "except Exception as error:\n    print(error)"
    )
    done = subprocess.run([sys.executable, "-c", code, path], capture_output=True, text=True, check=True)
    assert done.stdout.startswith("t.db: rule needs too much memory")


@pytest.mark.parametrize("value", ["zeroblob(900000000)", "replace(hex(zeroblob(10000)), '0', hex(zeroblob(10000)))"])
def test_a_view_may_not_make_a_large_value(tmp_path: Path, value: str) -> None:
    assert message(database(tmp_path, SELECT.format(value))).endswith("cannot be read: string or blob too big")


def test_a_large_value_that_no_row_shows_is_none_of_ours(tmp_path: Path) -> None:
    made = "CREATE TABLE t (x, pad); INSERT INTO t VALUES ('/x', zeroblob(1000000))"
    (row,) = rows(database(tmp_path, f"{SELECT.format('x')} FROM t ORDER BY 4", made))
    assert isinstance(row, TableRow)
    assert row.object == "/x"
