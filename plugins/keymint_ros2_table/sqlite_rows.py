# SPDX-License-Identifier: Apache-2.0
"""Read the rows of the table or view ``rule`` of an SQLite database.

The database is a copy in memory of bytes that were read once, so nothing is locked, written or attached. Its views are
code of others: they may only read and compute, must end, and must give the same rows for the same bytes.
"""

from __future__ import annotations

import contextlib
import resource
import sqlite3  # noqa: TID251 - in memory only: reads bytes
import sys
from collections.abc import Iterator, Sequence

from comarmor.errors import ComArmorError, Origin
from comarmor.language.attachments import strip
from comarmor.text import did_you_mean, quoted
from keymint_ros2_table.rows import COLUMNS, MOST_ROWS, REQUIRED, TableRow, column_order, row_origin

NAME = "rule"
MAGIC = b"SQLite format 3\0"
_WRITE_AHEAD, _ROLLBACK = b"\2\2", b"\1\1"
"""The bytes 18 and 19 of a file: versions of its format for writing and reading (SQLite, "Database File Format")."""
_HIDDEN = 1
"""What ``PRAGMA table_xinfo`` says about a column of a virtual table that ``*`` does not name."""
_STEPS_BETWEEN, _MOST_CHECKS = 10_000, 10_000
"""Instructions of SQLite's machine between two checks, and the most checks: some seconds."""
_MOST_BYTES = 1 << 14
"""The most bytes of a value that a query makes; so it takes little memory between two checks."""
_MOST_GROWTH = 1 << 15
"""How much the process may grow while a query runs, beside one for each row, in KiB.

SQLite has limits of memory for all databases of a process together only, and the register of certificates needs more.
"""
_CHANGING = frozenset((
    "random", "randomblob", "date", "time", "datetime", "julianday", "strftime", "unixepoch", "timediff",
    "current_date", "current_time", "current_timestamp", "changes", "total_changes", "last_insert_rowid",
    "load_extension", "fts3_tokenizer",
))  # fmt: skip
"""Functions whose results depend on more than the database, or that load code."""
_TYPES = {type(None): "NULL", int: "INTEGER", float: "REAL", bytes: "BLOB", str: "TEXT"}
_READING = frozenset((sqlite3.SQLITE_SELECT, sqlite3.SQLITE_READ, sqlite3.SQLITE_FUNCTION, sqlite3.SQLITE_RECURSIVE))


def rows_of(content: bytes, file: str) -> Iterator[TableRow | ComArmorError]:
    """Yield the rows; the error of a row in place of it.

    Args:
        content: the database.
        file: its path as the user would type it.

    Raises:
        ComArmorError: the database has no such table or view, or cannot be read.
    """
    where = Origin(file)
    if content[18:20] == _WRITE_AHEAD:  # a database in memory has no write-ahead log
        content = content[:18] + _ROLLBACK + content[20:]
    guard = _Guard()
    with contextlib.closing(sqlite3.connect(":memory:", isolation_level=None)) as database:
        try:
            database.deserialize(content)
            del content
            database.execute("PRAGMA temp_store = MEMORY")  # nothing is written, also not what a query sorts
            database.text_factory = lambda data: data.decode("utf-8", "surrogateescape")
            database.execute("PRAGMA trusted_schema = OFF")
            if database.execute("PRAGMA quick_check(1)").fetchone() != ("ok",):
                raise ComArmorError("the database is damaged", where=where, code="table-query")
            header = [
                name for _, name, *_, hidden in database.execute(f"PRAGMA table_xinfo({NAME})") if hidden != _HIDDEN
            ]
            if not header:
                raise _missing(database, where)
            order = column_order(header, where)
            database.set_authorizer(guard.authorize)
            database.set_progress_handler(guard.progress, _STEPS_BETWEEN)
            database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, _MOST_BYTES)
            guard.most_memory = _memory() + _MOST_GROWTH
            chosen = ", ".join(name if at >= 0 else "NULL" for name, at in zip(COLUMNS, order, strict=True))
            for number, values in enumerate(database.execute(f"SELECT {chosen} FROM {NAME}"), 1):  # noqa: S608 - constants
                if number > MOST_ROWS:
                    raise ComArmorError(
                        f"{NAME} has more than the {MOST_ROWS:,} rows allowed", where=where, code="table-limit"
                    )
                guard.most_memory += 1
                yield _row(values, file, number)
        except MemoryError:
            raise _too_much("needs too much memory", where) from None
        except sqlite3.Error as error:
            raise guard.refusal(error, where) from None


class _Guard:
    """Says what a query may do, and ends one that takes too long."""

    def __init__(self) -> None:
        self.refused = ""
        self.is_large = False
        self.checks = 0
        self.most_memory = 0

    def authorize(self, action: int, first: str | None, second: str | None, *_: object) -> int:
        """Allow reading and computing; see ``sqlite3_set_authorizer``."""
        if action in _READING and not (action == sqlite3.SQLITE_FUNCTION and (second or "").lower() in _CHANGING):
            return sqlite3.SQLITE_OK
        self.refused = f"the function {second}" if action == sqlite3.SQLITE_FUNCTION else (first or "a statement")
        return sqlite3.SQLITE_DENY

    def progress(self) -> bool:
        """Return whether the query must end."""
        self.checks += 1
        self.is_large = _memory() > self.most_memory
        return self.is_large or self.checks > _MOST_CHECKS

    def refusal(self, error: sqlite3.Error, where: Origin) -> ComArmorError:
        """Return the error for one of SQLite."""
        if self.refused:
            return ComArmorError(
                f"{NAME} uses {quoted(self.refused)}, which is not allowed: its rows must depend on the database alone",
                where=where, help="write what it computes into a table", code="table-query",
            )  # fmt: skip
        if self.is_large:
            return _too_much("needs too much memory", where)
        if self.checks > _MOST_CHECKS:
            return _too_much("takes too long to compute", where)
        return ComArmorError(f"the database cannot be read: {error}", where=where, code="table-query")


def _memory() -> int:
    """Return the memory of the process in KiB; without ``/proc``, the most that it had."""
    try:
        with open("/proc/self/statm", "rb") as numbers:  # noqa: PTH123 - asked ten thousand times
            return int(numbers.read().split()[1]) * resource.getpagesize() >> 10
    except OSError:
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss >> (10 if sys.platform == "darwin" else 0)


def _too_much(what: str, where: Origin) -> ComArmorError:
    help_ = "write what it computes into a table"
    return ComArmorError(f"{NAME} {what}", where=where, help=help_, code="table-limit")


def _missing(database: sqlite3.Connection, where: Origin) -> ComArmorError:
    names = [
        str(name) for (name,) in database.execute("SELECT name FROM sqlite_master WHERE type IN ('table', 'view')")
    ]
    return ComArmorError(
        f"the database has no table or view {NAME}", where=where, code="table-header",
        help=did_you_mean(NAME, names, f"create a view {NAME}({', '.join(COLUMNS)})"),
    )  # fmt: skip


def _row(values: Sequence[object], file: str, number: int) -> TableRow | ComArmorError:
    *required, audit, source = values
    try:
        where = row_origin(file, number, strip(source) if isinstance(source, str) else "")
        if not isinstance(source, str | None):
            raise _type_error("source", source, where)
        if not isinstance(audit, str | int | None):
            raise _type_error("audit", audit, where)
        texts = []
        for name, value in zip(REQUIRED, required, strict=True):
            if not isinstance(value, str):
                raise _type_error(name, value, where)
            texts.append(strip(value))
    except ComArmorError as error:
        return error
    # The column tells rows of one source apart where a line would; it is not shown.
    origin = Origin(where.file, 0, (), number) if source else where
    return TableRow.of([*texts, "" if audit is None else strip(str(audit))], where, origin)


def _type_error(column: str, value: object, where: Origin) -> ComArmorError:
    found = _TYPES[type(value)]
    return ComArmorError(f"{column} is {found}, expected TEXT", where=where, code="table-value")
