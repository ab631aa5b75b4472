# SPDX-License-Identifier: Apache-2.0
"""Tables for tests: CSV files and databases."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

HEADER = "subject,kind,permission,object,qualifier,audit,source\n"
COLUMNS = "(subject, kind, permission, object, qualifier, audit, source)"


def csv_file(folder: Path, *rows: str, header: str = HEADER) -> Path:
    path = folder / "rules.csv"
    path.write_text(header + "".join(f"{row}\n" for row in rows))
    return path


def database(folder: Path, select: str, before: str = "", name: str = "rules.db") -> Path:
    """Make a database whose view gives what a query selects."""
    path = folder / name
    path.unlink(missing_ok=True)
    with closing(sqlite3.connect(path)) as made:
        made.executescript(f"{before};CREATE VIEW rule {COLUMNS} AS {select};")
    return path
