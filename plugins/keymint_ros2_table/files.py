# SPDX-License-Identifier: Apache-2.0
"""Read a table's file once: its rows, and the fingerprints of all that they depend on."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from pathlib import Path

from comarmor.errors import ComArmorError, Origin
from comarmor.xml.sandboxed_paths import path_text, read_bounded, read_failure
from keymint_ros2_table import sqlite_rows
from keymint_ros2_table.rows import TableRow, is_header, rows_of_csv

_MOST_CSV, _MOST_SQLITE = 16 * 2**20, 32 * 2**20
"""Bytes of a file."""
_CSV = ".csv"
_LOG, _JOURNAL = "-wal", "-journal"
"""Suffixes of the files beside a database that have changes which are not in it, or which must be undone."""
_FIRST_LINE = 4096
_INACTIVE = b"\0" * 8
"""What a journal begins with that was kept after its transaction ended."""


def read(path: Path) -> tuple[Iterator[TableRow | ComArmorError], Mapping[Path, bytes]]:
    """Return the rows of a table, with errors in place of defect ones, and the fingerprints of all its files.

    Args:
        path: its file.

    Raises:
        ComArmorError: it is missing, too large, or being written to.
    """
    file = path_text(str(path))
    try:
        real = path.resolve(strict=True)
        if real.is_dir():
            raise ComArmorError(
                "is a folder, expected a table", where=Origin(file), help="name a CSV file or an SQLite database",
                code="policy-missing",
            )  # fmt: skip
        before = real.stat()
        content = read_bounded(real.parent, real, _MOST_SQLITE + 1)
    except (OSError, RuntimeError, ValueError) as error:
        raise ComArmorError(read_failure(error, "the table"), where=Origin(file), code="policy-missing") from None
    seen = {path: hashlib.sha256(content).digest()}
    is_database = content.startswith(sqlite_rows.MAGIC)
    most = _MOST_SQLITE if is_database else _MOST_CSV
    if len(content) > most:
        raise ComArmorError(
            f"the table has more than the {most:,} bytes allowed", where=Origin(file), code="table-limit"
        )
    if not is_database:
        return rows_of_csv(content, file), seen
    for suffix in (_LOG, _JOURNAL):
        beside = real.with_name(f"{real.name}{suffix}")
        seen[beside] = _require_none(beside, file)
    after = real.stat()
    if (before.st_mtime_ns, before.st_size, before.st_ino) != (after.st_mtime_ns, after.st_size, after.st_ino):
        raise _in_use(file, "was written to while it was read")
    return sqlite_rows.rows_of(content, file), seen


def recognises(path: Path) -> bool:
    """Tell whether a file is a table of rules, valid or not; whatever is called ``*.csv`` is meant as one."""
    try:
        real = path.resolve(strict=True)
        begin = read_bounded(real.parent, real, _FIRST_LINE)
    except (OSError, RuntimeError, ValueError):
        return False
    if begin.startswith(sqlite_rows.MAGIC) or path.suffix.lower() == _CSV:
        return True
    first = begin.decode("utf-8-sig", "replace").lstrip("\r\n").splitlines()[:1]
    return is_header("".join(first))


def _require_none(beside: Path, file: str) -> bytes:
    """Return the fingerprint of a file beside a database that has nothing in it.

    Raises:
        ComArmorError: it has changes.
    """
    try:
        content = read_bounded(beside.parent, beside, _MOST_SQLITE)
    except FileNotFoundError:
        return b""
    except OSError as error:
        raise ComArmorError(
            read_failure(error, "the file"), where=Origin(f"{file}{beside.suffix}"), code="unreadable"
        ) from None
    if content and not (beside.name.endswith(_JOURNAL) and content.startswith(_INACTIVE)):
        raise _in_use(file, f"has changes in {beside.name} that are not in it yet, or that must be undone")
    return hashlib.sha256(content).digest()


def _in_use(file: str, message: str) -> ComArmorError:
    return ComArmorError(
        f"the database {message}", where=Origin(file), code="table-in-use",
        help="take a copy of it by 'VACUUM INTO', which is complete, and name the copy",
    )  # fmt: skip
