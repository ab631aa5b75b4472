# SPDX-License-Identifier: Apache-2.0
"""The file of the register: an SQLite database, read and written as a whole.

It is made in memory, so that it is written like every other file: complete, atomic, and 0600 from its first byte.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import Field, fields
from datetime import UTC, datetime
from typing import Any

from comarmor.errors import Origin
from keymint.errors import KeymintError
from keymint.life.issued_certificates import REASONS, IssuedCertificate, Register, SignedRights

_APPLICATION = 0x4B594D54  # "KYMT", for file(1)
_VERSION = 2
_WITHOUT_RIGHTS = 1
"""The version that had no signed documents."""
_MAX_NUMBER = 1 << 62
_WAL = b"\2\2"
"""The header's versions of a database in write-ahead mode (SQLite file format, 1.3.3)."""
_SERIAL = "serial"
"""The field of a number of up to 160 bits, which is hexadecimal in the file."""
_COLUMNS: Mapping[str, tuple[str, Any]] = {
    "str": ("TEXT NOT NULL", str),
    "int": ("INTEGER NOT NULL", int),
    "bytes": ("BLOB NOT NULL", bytes),
    "datetime": ("TEXT NOT NULL", str),
    "datetime | None": ("TEXT", str | None),
}
"""The column of a field by its type, and the type of what is stored."""
_TABLES = {"certificates": IssuedCertificate, "rights": SignedRights}
"""Tables with a column for each field, in their order."""
_NUMBERED = ("lists", "bundles")


def _column(field: Field[Any]) -> tuple[str, Any]:
    return _COLUMNS["str" if field.name == _SERIAL else str(field.type)]


def _schema() -> Iterator[str]:
    """Yield the statements that make an empty register."""
    yield f"PRAGMA application_id = {_APPLICATION}"
    yield f"PRAGMA user_version = {_VERSION}"
    for table, kind in _TABLES.items():
        columns = (f"{field.name} {_column(field)[0]}" for field in fields(kind))
        yield f"CREATE TABLE {table} (number INTEGER PRIMARY KEY, {', '.join(columns)})"
    yield f"CREATE UNIQUE INDEX issued ON certificates (issuer, {_SERIAL})"
    yield "CREATE TABLE lists (issuer TEXT PRIMARY KEY, number INTEGER NOT NULL)"
    yield "CREATE TABLE bundles (name TEXT PRIMARY KEY, number INTEGER NOT NULL)"
    yield "CREATE TABLE history (is_whole INTEGER NOT NULL)"


def load(content: bytes, where: Origin) -> Register:
    """Return the register of a file.

    Args:
        content: the file's bytes.
        where: the file, for messages.

    Raises:
        KeymintError: it is damaged, or a later version of Keymint wrote it.
    """
    if not content:
        raise register_error(where)
    import sqlite3  # noqa: PLC0415, TID251 - in memory only, and of no use to runs that issue nothing

    try:
        with contextlib.closing(sqlite3.connect(":memory:")) as database:
            if content[18:20] == _WAL:  # another tool looked into it; a database in memory cannot have that mode
                content = content[:18] + b"\1\1" + content[20:]
            database.deserialize(content)
            (version,) = database.execute("PRAGMA user_version").fetchone()
            if version not in (_WITHOUT_RIGHTS, _VERSION):
                raise KeymintError(
                    f"is a register of version {version}, expected {_VERSION}",
                    where=where,
                    help="use the version of Keymint that wrote it",
                    code="register-version",
                )
            if database.execute("PRAGMA quick_check").fetchone() != ("ok",):
                raise register_error(where)
            issued = _entries(database, "certificates")
            _require_possible(issued)
            numbers, bundles = (dict(map(_numbered, database.execute(f"SELECT * FROM {name}"))) for name in _NUMBERED)  # noqa: S608 - constants
            signed, is_whole = (), False
            if version == _VERSION:
                signed = _entries(database, "rights")
                ((is_whole,),) = database.execute("SELECT is_whole FROM history").fetchall()
    except (sqlite3.Error, ValueError, TypeError, OverflowError):
        raise register_error(where) from None
    known = {(each.issuer, each.serial): each for each in issued}
    return Register(known, numbers, bundles, signed, is_whole == 1)


def _entries(database: Any, table: str) -> tuple[Any, ...]:
    """Return the entries of a table.

    Raises:
        TypeError: a value is not one that :func:`dump` writes.
        ValueError: the same.
    """
    own = fields(_TABLES[table])
    rows = database.execute(f"SELECT {', '.join(each.name for each in own)} FROM {table} ORDER BY number")  # noqa: S608 - constants
    return tuple(_TABLES[table](*map(_value, own, row)) for row in rows)


def _value(field: Field[Any], stored: Any) -> Any:
    if not isinstance(stored, _column(field)[1]):
        raise TypeError
    if field.name == _SERIAL:
        return int(stored, 16)
    return stored if stored is None or "datetime" not in str(field.type) else _moment(stored)


def _require_possible(issued: Iterable[IssuedCertificate]) -> None:
    for each in issued:
        if each.generation < 0 or (each.revoked is None) != (not each.reason) or each.reason not in ("", *REASONS):
            raise ValueError


def dump(register: Register) -> bytes:
    """Return the file of a register."""
    import sqlite3  # noqa: PLC0415, TID251 - in memory only, and of no use to runs that issue nothing

    with contextlib.closing(sqlite3.connect(":memory:")) as database:
        for statement in _schema():
            database.execute(statement)
        entries = zip(_TABLES.items(), (register.certificates.values(), register.rights), strict=True)
        for (table, kind), rows in entries:
            names = [field.name for field in fields(kind)]
            insert = f"INSERT INTO {table} ({', '.join(names)}) VALUES ({', '.join('?' * len(names))})"  # noqa: S608 - constants
            database.executemany(insert, ([_stored(name, getattr(each, name)) for name in names] for each in rows))
        for table, numbers in zip(_NUMBERED, (register.numbers, register.bundles), strict=True):
            database.executemany(f"INSERT INTO {table} VALUES (?, ?)", sorted(numbers.items()))  # noqa: S608 - constants
        database.execute("INSERT INTO history VALUES (?)", (int(register.is_whole),))
        database.commit()
        return database.serialize()


def _stored(name: str, value: Any) -> object:
    if name == _SERIAL:
        return f"{value:x}"
    return value.isoformat() if isinstance(value, datetime) else value


def _moment(text: str) -> datetime:
    moment = datetime.fromisoformat(text)
    if moment.tzinfo is None:
        raise ValueError
    return moment.astimezone(UTC)


def _numbered(row: tuple[object, ...]) -> tuple[str, int]:
    name, number = row
    if not isinstance(name, str) or not isinstance(number, int) or not 0 < number < _MAX_NUMBER:
        raise ValueError
    return name, number


def register_error(where: Origin) -> KeymintError:
    """Return the error about a register that cannot be read."""
    return KeymintError(
        "is not a register of issued certificates, or a damaged one",
        where=where,
        help="restore it from a backup; without one remove it, and 'keymint crl --rebuild' makes it again from the "
        "certificates and revocation lists that are here",
        code="register-damaged",
    )
