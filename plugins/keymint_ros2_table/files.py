# SPDX-License-Identifier: Apache-2.0
"""Read a table's file once: its rows, and the fingerprints of all that they depend on.

A file is CSV (:mod:`rows`), or an SQLite database with a table or view ``rule``. The database is a copy in memory of
bytes that were read once, so nothing is locked, written or attached. Its views are code of others: they may only read
and compute, must end, and must give the same rows for the same bytes.
"""

from __future__ import annotations

import contextlib
import hashlib
import resource
import sqlite3  # noqa: TID251 - in memory only: reads bytes
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from comarmor.language.attachments import strip
from comarmor.text import did_you_mean, quote
from comarmor.values import replace
from comarmor.xml.sandboxed_paths import file_errors, path_text, read_bounded
from keymint.errors import KeymintError, Origin
from keymint_ros2_table import rows

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
_ACCEPTED = ((-1, (str, type(None))), (-2, (str, int, type(None))), *((at, (str,)) for at in range(len(rows.REQUIRED))))
"""The place of each column and the types of its values, in the order in which they are checked."""
_READING = frozenset((sqlite3.SQLITE_SELECT, sqlite3.SQLITE_READ, sqlite3.SQLITE_FUNCTION, sqlite3.SQLITE_RECURSIVE))


def rows_of_database(content: bytes, file: str) -> Iterator[rows.TableRow | KeymintError]:
    """Yield the rows; the error of a row in place of it.

    Args:
        content: the database.
        file: its path as the user would type it.

    Raises:
        KeymintError: the database has no such table or view, or cannot be read.
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
                raise KeymintError("the database is damaged", where=where, code="table-query")
            header = [
                name for _, name, *_, hidden in database.execute(f"PRAGMA table_xinfo({NAME})") if hidden != _HIDDEN
            ]
            if not header:
                found = database.execute("SELECT name FROM sqlite_master WHERE type IN ('table', 'view')")
                usual = f"create a view {NAME}({', '.join(rows.COLUMNS)})"
                message = f"the database has no table or view {NAME}"
                help_ = did_you_mean(NAME, [str(name) for (name,) in found], usual)
                raise KeymintError(message, where=where, help=help_, code="table-header")
            order = rows.column_order(header, where)
            database.set_authorizer(guard.authorize)
            database.set_progress_handler(guard.progress, _STEPS_BETWEEN)
            database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, _MOST_BYTES)
            guard.most_memory = _memory() + _MOST_GROWTH
            chosen = ", ".join(name if at >= 0 else "NULL" for name, at in zip(rows.COLUMNS, order, strict=True))
            for number, values in enumerate(database.execute(f"SELECT {chosen} FROM {NAME}"), 1):  # noqa: S608 - constants
                if number > rows.MOST_ROWS:
                    message = f"{NAME} has more than the {rows.MOST_ROWS:,} rows allowed"
                    raise KeymintError(message, where=where, code="table-limit")
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

    def refusal(self, error: sqlite3.Error, where: Origin) -> KeymintError:
        """Return the error for one of SQLite."""
        if self.refused:
            return KeymintError(
                f"{NAME} uses {quote(self.refused)}, which is not allowed: its rows must depend on the database alone",
                where=where, help="write what it computes into a table", code="table-query",
            )  # fmt: skip
        if self.is_large:
            return _too_much("needs too much memory", where)
        if self.checks > _MOST_CHECKS:
            return _too_much("takes too long to compute", where)
        return KeymintError(f"the database cannot be read: {error}", where=where, code="table-query")


def _memory() -> int:
    """Return the memory of the process in KiB; without ``/proc``, the most that it had."""
    try:
        with open("/proc/self/statm", "rb") as numbers:  # noqa: PTH123 - asked ten thousand times
            return int(numbers.read().split()[1]) * resource.getpagesize() >> 10
    except OSError:
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss >> (10 if sys.platform == "darwin" else 0)


def _too_much(what: str, where: Origin) -> KeymintError:
    help_ = "write what it computes into a table"
    return KeymintError(f"{NAME} {what}", where=where, help=help_, code="table-limit")


def _row(values: Sequence[object], file: str, number: int) -> rows.TableRow | KeymintError:
    *texts, source = values
    try:
        where = rows.row_origin(file, number, strip(source) if isinstance(source, str) else "")
    except KeymintError as error:
        return error
    for at, accepted in _ACCEPTED:
        if not isinstance(values[at], accepted):
            found = _TYPES[type(values[at])]
            return KeymintError(f"{rows.COLUMNS[at]} is {found}, expected TEXT", where=where, code="table-value")
    # The column tells rows of one source apart where a line would; it is not shown.
    origin = replace(where, line=0, column=number) if source else where
    return rows.TableRow(where, origin, *["" if text is None else strip(str(text)) for text in texts])


_MOST_CSV, _MOST_SQLITE = 16 * 2**20, 32 * 2**20
"""Bytes of a file."""
_CSV = ".csv"
_LOG, _JOURNAL = "-wal", "-journal"
"""Suffixes of the files beside a database that have changes which are not in it, or which must be undone."""
_FIRST_LINE = 4096
_INACTIVE = b"\0" * 8
"""What a journal begins with that was kept after its transaction ended."""


def read(path: Path) -> tuple[Iterator[rows.TableRow | KeymintError], Mapping[Path, bytes]]:
    """Return the rows of a table, with errors in place of defect ones, and the fingerprints of all its files.

    Args:
        path: its file.

    Raises:
        KeymintError: it is missing, too large, or being written to.
    """
    file = path_text(str(path))
    with file_errors("the table", Origin(file), "policy-missing"):
        real = path.resolve(strict=True)
        if real.is_dir():
            message, help_ = "is a folder, expected a table", "name a CSV file or an SQLite database"
            raise KeymintError(message, where=Origin(file), help=help_, code="policy-missing")
        before = real.stat()
        content = read_bounded(real.parent, real, _MOST_SQLITE + 1)
    seen = {path: hashlib.sha256(content).digest()}
    is_database = content.startswith(MAGIC)
    most = _MOST_SQLITE if is_database else _MOST_CSV
    if len(content) > most:
        message = f"the table has more than the {most:,} bytes allowed"
        raise KeymintError(message, where=Origin(file), code="table-limit")
    if not is_database:
        return rows.rows_of_csv(content, file), seen
    for suffix in (_LOG, _JOURNAL):
        beside = real.with_name(f"{real.name}{suffix}")
        seen[beside] = _require_none(beside, file)
    after = real.stat()
    if (before.st_mtime_ns, before.st_size, before.st_ino) != (after.st_mtime_ns, after.st_size, after.st_ino):
        raise _in_use(file, "was written to while it was read")
    return rows_of_database(content, file), seen


def recognises(path: Path) -> bool:
    """Tell whether a file is a table of rules, valid or not; whatever is called ``*.csv`` is meant as one."""
    try:
        real = path.resolve(strict=True)
        begin = read_bounded(real.parent, real, _FIRST_LINE)
    except (OSError, RuntimeError, ValueError):
        return False
    if begin.startswith(MAGIC) or path.suffix.lower() == _CSV:
        return True
    first = begin.decode("utf-8-sig", "replace").lstrip("\r\n").splitlines()[:1]
    return rows.is_header("".join(first))


def _require_none(beside: Path, file: str) -> bytes:
    """Return the fingerprint of a file beside a database that has nothing in it.

    Raises:
        KeymintError: it has changes.
    """
    with file_errors("the file", Origin(f"{file}{beside.suffix}")), contextlib.suppress(FileNotFoundError):
        content = read_bounded(beside.parent, beside, _MOST_SQLITE)
        if content and not (beside.name.endswith(_JOURNAL) and content.startswith(_INACTIVE)):
            raise _in_use(file, f"has changes in {beside.name} that are not in it yet, or that must be undone")
        return hashlib.sha256(content).digest()
    return b""


def _in_use(file: str, message: str) -> KeymintError:
    return KeymintError(
        f"the database {message}", where=Origin(file), code="table-in-use",
        help="take a copy of it by 'VACUUM INTO', which is complete, and name the copy",
    )  # fmt: skip
