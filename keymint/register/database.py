# SPDX-License-Identifier: Apache-2.0
"""The file of the register: an SQLite database, read and written as a whole.

It is made in memory, so that it is written like every other file: complete, atomic, and 0600 from its first byte.
"""

from __future__ import annotations

import contextlib
from dataclasses import fields
from datetime import UTC, datetime
from typing import Any

from comarmor.errors import Origin
from keymint.errors import KeymintError
from keymint.register.register import REASONS, IssuedCertificate, Register, SignedRights

_APPLICATION = 0x4B594D54  # "KYMT", for file(1)
_VERSION = 2
_WITHOUT_RIGHTS = 1
"""The version that had no signed documents."""
_MAX_NUMBER = 1 << 62
_WAL = b"\2\2"
"""The header's versions of a database in write-ahead mode (SQLite file format, 1.3.3)."""
_SCHEMA = f"""
PRAGMA application_id = {_APPLICATION};
PRAGMA user_version = {_VERSION};
CREATE TABLE certificates (
    number INTEGER PRIMARY KEY,
    issuer TEXT NOT NULL,
    serial TEXT NOT NULL,
    authority TEXT NOT NULL,
    name TEXT NOT NULL,
    generation INTEGER NOT NULL,
    not_before TEXT NOT NULL,
    not_after TEXT NOT NULL,
    key TEXT NOT NULL,
    rights TEXT NOT NULL,
    revoked TEXT,
    reason TEXT NOT NULL,
    UNIQUE (issuer, serial)
);
CREATE TABLE lists (issuer TEXT PRIMARY KEY, number INTEGER NOT NULL);
CREATE TABLE bundles (name TEXT PRIMARY KEY, number INTEGER NOT NULL);
CREATE TABLE rights (
    number INTEGER PRIMARY KEY,
    name TEXT NOT NULL,
    generation INTEGER NOT NULL,
    subject TEXT NOT NULL,
    not_after TEXT NOT NULL,
    compressed BLOB NOT NULL,
    accepted TEXT
);
CREATE TABLE history (is_whole INTEGER NOT NULL);
"""
_RIGHTS = "name, generation, subject, not_after, compressed, accepted"
_FIELDS = tuple(field.name for field in fields(IssuedCertificate))
_COLUMNS = ", ".join(_FIELDS)


def load(content: bytes, where: Origin) -> Register:
    """Return the register of a file.

    Args:
        content: the file's bytes.
        where: the file, for messages.

    Raises:
        KeymintError: it is damaged, or a later version of Keymint wrote it.
    """
    if not content:
        raise damaged(where)
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
                raise damaged(where)
            rows = database.execute(f"SELECT {_COLUMNS} FROM certificates ORDER BY number")  # noqa: S608 - constant
            issued = [_certificate(row) for row in rows]
            numbers, bundles = (dict(map(_numbered, database.execute(f"SELECT * FROM {name}"))) for name in _NUMBERED)  # noqa: S608 - constants
            signed, is_whole = _signed(database) if version == _VERSION else ((), False)
    except (sqlite3.Error, ValueError, TypeError, OverflowError):
        raise damaged(where) from None
    known = {(each.issuer, each.serial): each for each in issued}
    return Register(known, numbers, bundles, signed, is_whole)


def _signed(database: Any) -> tuple[tuple[SignedRights, ...], bool]:
    """Return the signed documents of a database, and whether it has all that were ever signed.

    Raises:
        ValueError: a value is not one that :func:`dump` writes.
    """
    ((is_whole,),) = database.execute("SELECT is_whole FROM history").fetchall()
    rows = database.execute(f"SELECT {_RIGHTS} FROM rights ORDER BY number")  # noqa: S608 - constant
    return tuple(map(_rights, rows)), is_whole == 1


def _rights(row: tuple[Any, ...]) -> SignedRights:
    name, generation, subject, end, compressed, accepted = row
    kinds = (name, str), (subject, str), (end, str), (generation, int), (compressed, bytes)
    if not all(isinstance(value, kind) for value, kind in kinds):
        raise ValueError
    return SignedRights(name, generation, subject, _moment(end), compressed, _moment(accepted) if accepted else None)


_NUMBERED = ("lists", "bundles")


def dump(register: Register) -> bytes:
    """Return the file of a register."""
    import sqlite3  # noqa: PLC0415, TID251 - in memory only, and of no use to runs that issue nothing

    with contextlib.closing(sqlite3.connect(":memory:")) as database:
        database.executescript(_SCHEMA)
        database.executemany(
            f"INSERT INTO certificates ({_COLUMNS}) VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)",  # noqa: S608 - constant
            map(_row, register.certificates.values()),
        )
        database.executemany("INSERT INTO lists VALUES (?, ?)", sorted(register.numbers.items()))
        database.executemany("INSERT INTO bundles VALUES (?, ?)", sorted(register.bundles.items()))
        database.executemany(
            f"INSERT INTO rights ({_RIGHTS}) VALUES (?, ?, ?, ?, ?, ?)",  # noqa: S608 - constant
            (
                (each.name, each.generation, each.subject, each.not_after.isoformat(), each.compressed,
                 each.accepted and each.accepted.isoformat())
                for each in register.rights
            ),
        )  # fmt: skip
        database.execute("INSERT INTO history VALUES (?)", (int(register.is_whole),))
        database.commit()
        return database.serialize()


def _row(each: IssuedCertificate) -> tuple[object, ...]:
    issuer, serial, *rest = (getattr(each, name) for name in _FIELDS)
    return issuer, f"{serial:x}", *(value.isoformat() if isinstance(value, datetime) else value for value in rest)


def _certificate(row: tuple[Any, ...]) -> IssuedCertificate:
    """Return the certificate of a row.

    Raises:
        ValueError: a value is not one that :func:`dump` writes.
    """
    issuer, serial, authority, name, generation, first, last, key, rights, revoked, reason = row
    texts = (issuer, serial, authority, name, first, last, key, rights, reason)
    if not all(isinstance(each, str) for each in texts) or not isinstance(generation, int) or generation < 0:
        raise ValueError
    if (revoked is None) != (not reason) or reason not in ("", *REASONS):
        raise ValueError
    end = None if revoked is None else _moment(revoked)
    period = _moment(first), _moment(last)
    return IssuedCertificate(issuer, int(serial, 16), authority, name, generation, *period, key, rights, end, reason)


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


def damaged(where: Origin) -> KeymintError:
    """Return the error about a register that cannot be read."""
    return KeymintError(
        "is not a register of issued certificates, or a damaged one",
        where=where,
        help="restore it from a backup; without one remove it, and 'keymint crl --rebuild' makes it again from the "
        "certificates and revocation lists that are here",
        code="register-damaged",
    )
