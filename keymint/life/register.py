# SPDX-License-Identifier: Apache-2.0
"""The register: what a workspace's authorities issued, who holds which certificate, and which of them are revoked.

Its file is an SQLite database, read and written as a whole. It is made in memory, so that it is written like every
other file: complete, atomic, and 0600 from its first byte.
"""

from __future__ import annotations

import contextlib
import functools
import weakref
import zlib
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

from comarmor.values import Data, field, replace
from keymint.errors import KeymintError, Origin

SUPERSEDED = "superseded"
"""The reason of a revocation after which the same key may be certified again."""
UNKNOWN = "unspecified"
REASONS = (SUPERSEDED, "key-compromise", "retired", "affiliation-changed", "privilege-withdrawn", UNKNOWN)
"""Reasons of a revocation (RFC 5280, 5.3.1); ``retired`` is its cessationOfOperation."""


class IssuedCertificate(Data):
    """A certificate that was issued, and the rights that were signed for it last.

    Attributes:
        issuer: fingerprint of the authority's public key (SHA-256, hexadecimal).
        serial: its serial number; unique for each issuer (RFC 5280, 4.1.2.2).
        authority: name of the authority.
        name: the package; empty if only the revocation is known.
        generation: generation of the subject name, see ADR 0029.
        not_before: begin of its validity, UTC.
        not_after: end of its validity, UTC.
        key: fingerprint of the certified public key; empty if only the revocation is known.
        rights: digest of the package's unsigned documents, which were signed last.
        revoked: when it was revoked, UTC; None if it was not.
        reason: why, one of :data:`REASONS`; empty if it was not revoked.
        issued: when it was issued, UTC; None if that is not known, e.g. of one that an earlier version issued.
    """

    issuer: str
    serial: int
    authority: str
    name: str
    generation: int
    not_before: datetime
    not_after: datetime
    key: str
    rights: str = ""
    revoked: datetime | None = None
    reason: str = ""
    issued: datetime | None = None


class SignedRights(Data):
    """A document that was signed: whoever has a certificate for its name may present it until it ends.

    Attributes:
        name: the package.
        generation: generation of the subject name, see ADR 0029.
        subject: distinguished name of the certificate, in certificate order.
        not_after: end of the rights, UTC.
        compressed: what was signed, as :func:`zlib.compress` makes it.
        accepted: when the owner accepted that it stays good beside later ones, UTC; None if that was not said.
    """

    name: str
    generation: int
    subject: str
    not_after: datetime
    compressed: bytes = field(repr=False)
    accepted: datetime | None = None

    @classmethod
    def of(cls, name: str, generation: int, subject: str, not_after: datetime, content: bytes) -> SignedRights:
        """Return the entry of a document for the register; the arguments are as the attributes."""
        # A window larger than the content takes memory that the system provides again each time: ten times the cost.
        bits = max(9, min(len(content).bit_length(), zlib.MAX_WBITS))
        packed = zlib.compressobj(1, zlib.DEFLATED, bits, bits + zlib.DEF_MEM_LEVEL - zlib.MAX_WBITS)
        return cls(name, generation, subject, not_after, packed.compress(content) + packed.flush())

    @property
    def content(self) -> bytes:
        """What was signed.

        Raises:
            ValueError: the entry is damaged.
        """
        inflated = zlib.decompressobj()
        with contextlib.suppress(zlib.error):
            content = inflated.decompress(self.compressed, _MOST)
        if not inflated.eof:
            raise ValueError
        return content


_MOST = 64 << 20
"""Largest signed document in bytes that is read."""


class Register(Data, slots=False):
    """All issued certificates in the order of their issue, and the number of the last revocation list of each issuer.

    Attributes:
        certificates: by issuer and serial number.
        numbers: the last number of a revocation list, by issuer (RFC 5280, 5.2.3).
        bundles: the last issue number of a bundle, by package.
        rights: the signed documents in the order of their issue.
        is_whole: it has all documents that were ever signed; else some may be missing.
    """

    certificates: Mapping[tuple[str, int], IssuedCertificate] = field(default_factory=dict)
    numbers: Mapping[str, int] = field(default_factory=dict)
    bundles: Mapping[str, int] = field(default_factory=dict)
    rights: tuple[SignedRights, ...] = ()
    is_whole: bool = True

    # -- questions -----------------------------------------------------------------------------------------------

    def of(self, name: str) -> tuple[IssuedCertificate, ...]:
        """Return the certificates of a package in the order of their issue."""
        return self._by_name.get(name, ())

    def in_force(self, name: str, at: datetime) -> tuple[IssuedCertificate, ...]:
        """Return the certificates of a package that are not revoked and do not end before a moment."""
        return tuple(each for each in self.of(name) if each.revoked is None and each.not_after >= at)

    def revoked(self, issuer: str) -> tuple[IssuedCertificate, ...]:
        """Return the revoked certificates of an issuer in the order of their issue."""
        return self._revoked.get(issuer, ())

    def is_revoked(self, issuer: str, serial: int) -> bool:
        """Tell whether a certificate is known and revoked."""
        known = self.certificates.get((issuer, serial))
        return known is not None and known.revoked is not None

    def barred(self, key: str) -> str:
        """Return why a key must not be certified again, or an empty text.

        Args:
            key: fingerprint of the public key.
        """
        return self._barred.get(key, "")

    def withdrawn(self, name: str) -> str:
        """Return why a package has no certificate any more, or an empty text if it has one or never had any."""
        last = self.of(name)[-1:]
        return next((each.reason for each in last if each.revoked and each.reason != SUPERSEDED), "")

    def generation(self, name: str) -> int:
        """Return the lowest generation that may be issued to a package: one after the last that was revoked."""
        return max((each.generation + 1 if each.revoked else each.generation for each in self.of(name)), default=0)

    @functools.cached_property
    def _by_name(self) -> Mapping[str, tuple[IssuedCertificate, ...]]:
        return _grouped((each.name, each) for each in self.certificates.values())

    @functools.cached_property
    def _revoked(self) -> Mapping[str, tuple[IssuedCertificate, ...]]:
        return _grouped((each.issuer, each) for each in self.certificates.values() if each.revoked)

    @functools.cached_property
    def _barred(self) -> Mapping[str, str]:
        revoked = (each for each in self.certificates.values() if each.revoked and each.reason != SUPERSEDED)
        return {each.key: each.reason for each in revoked if each.key}

    # -- changes -------------------------------------------------------------------------------------------------

    def with_issued(self, issued: Iterable[IssuedCertificate]) -> Register:
        """Return the register with more certificates; what is known of a certificate's issue and revocation stays."""
        certificates = dict(self.certificates)
        for each in issued:
            known = certificates.get((each.issuer, each.serial))
            new = each if known is None or each.issued == known.issued else replace(each, issued=known.issued)
            if known and known.revoked:
                new = replace(new, revoked=known.revoked, reason=known.reason)
            certificates[each.issuer, each.serial] = new
        return replace(self, certificates=certificates)

    def with_revoked(self, revoked: Collection[IssuedCertificate], reason: str, at: datetime) -> Register:
        """Return the register after the revocation of some of its certificates; one that is revoked stays as it is.

        Args:
            revoked: the certificates.
            reason: one of :data:`REASONS`.
            at: when, UTC.
        """
        new = [replace(each, revoked=at, reason=reason) for each in revoked if each.revoked is None]
        return replace(self, certificates={**self.certificates, **{(each.issuer, each.serial): each for each in new}})

    def with_rights(self, signed: Iterable[SignedRights]) -> Register:
        """Return the register with more signed documents; one that has ended stays, as the clock may be wrong."""
        known = {each.compressed for each in self.rights}
        return replace(self, rights=(*self.rights, *(each for each in signed if each.compressed not in known)))

    def with_accepted(self, names: Collection[str], at: datetime) -> Register:
        """Return the register after its owner accepted that earlier rights of some packages stay good.

        Args:
            names: the packages.
            at: when, UTC.
        """
        rights = (
            replace(each, accepted=at) if each.name in names and not each.accepted else each for each in self.rights
        )
        return replace(self, rights=tuple(rights))

    def with_number(self, issuer: str, number: int) -> Register:
        """Return the register after the issue of a revocation list; a number never goes back."""
        return replace(self, numbers={**self.numbers, issuer: max(number, self.numbers.get(issuer, 0))})

    def with_bundle(self, name: str, at: datetime) -> Register:
        """Return the register after the issue of a bundle, whose number is that of ``bundles``.

        Numbers are at least the seconds since 1970, so that they rise also after the register was lost.

        Args:
            name: the package.
            at: the clock, UTC.
        """
        return replace(self, bundles={**self.bundles, name: max(self.bundles.get(name, 0) + 1, int(at.timestamp()))})


def _grouped(pairs: Iterable[tuple[str, IssuedCertificate]]) -> Mapping[str, tuple[IssuedCertificate, ...]]:
    groups: dict[str, list[IssuedCertificate]] = {}
    for key, each in pairs:
        groups.setdefault(key, []).append(each)
    return {key: tuple(group) for key, group in groups.items()}


# -- its file -------------------------------------------------------------------------------------------------------

_APPLICATION = 0x4B594D54  # "KYMT", for file(1)
_VERSION = 3
_WITHOUT_RIGHTS = 1
"""The version that had no signed documents."""
_SINCE = {"issued": 3}
"""The versions that have a column which earlier ones lack."""
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
_TABLES: Mapping[str, type[Any]] = {"certificates": IssuedCertificate, "rights": SignedRights}
"""Tables with a column for each field, in their order."""
_NUMBERED = ("lists", "bundles")


def _column(name: str, kind: str) -> tuple[str, Any]:
    return _COLUMNS["str" if name == _SERIAL else kind]


@functools.lru_cache(maxsize=2)  # each stage of a run reads it
def loaded_register(content: bytes, where: Origin) -> Register:
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
            if not _WITHOUT_RIGHTS <= version <= _VERSION:
                raise KeymintError(
                    f"is a register of version {version}, expected {_VERSION}",
                    where=where,
                    help="use the version of Keymint that wrote it",
                    code="register-version",
                )
            if database.execute("PRAGMA quick_check").fetchone() != ("ok",):
                raise register_error(where)
            issued = _entries(database, "certificates", version)
            if any(
                each.generation < 0 or (each.revoked is None) != (not each.reason) or each.reason not in ("", *REASONS)
                for each in issued
            ):
                raise register_error(where)
            numbers, bundles = (dict(map(_numbered, database.execute(f"SELECT * FROM {name}"))) for name in _NUMBERED)  # noqa: S608 - constants
            signed, is_whole = (), False
            if version > _WITHOUT_RIGHTS:
                signed = _entries(database, "rights", version)
                ((is_whole,),) = database.execute("SELECT is_whole FROM history").fetchall()
    except (sqlite3.Error, ValueError, TypeError, OverflowError):
        raise register_error(where) from None
    known = {(each.issuer, each.serial): each for each in issued}
    return Register(known, numbers, bundles, signed, is_whole == 1)


def _entries(database: Any, table: str, version: int) -> tuple[Any, ...]:
    """Return the entries of a table.

    Raises:
        TypeError: a value is not one that :func:`register_content` makes.
        ValueError: the same.
    """
    own = {name: kind for name, kind in _TABLES[table].__annotations__.items() if _SINCE.get(name, 0) <= version}
    rows = database.execute(f"SELECT {', '.join(own)} FROM {table} ORDER BY number")  # noqa: S608 - constants
    values = [*map(_values, own, own.values(), zip(*rows, strict=True))]  # a column each; none if there are no rows
    return tuple(map(_TABLES[table], *values)) if values else ()


def _values(name: str, type_: str, stored: Sequence[Any]) -> Sequence[Any]:
    """Return the values of a field from those of its column."""
    if not all(issubclass(kind, _column(name, type_)[1]) for kind in set(map(type, stored))):
        raise TypeError
    if name == _SERIAL:
        return [int(each, 16) for each in stored]
    if "datetime" not in type_:
        return stored
    return [None if each is None else _moment(each) for each in stored]


@functools.lru_cache(maxsize=256)  # many were issued at once
def _moment(stored: str) -> datetime:
    if (moment := datetime.fromisoformat(stored)).tzinfo is None:
        raise ValueError
    return moment.astimezone(UTC)


def register_content(register: Register) -> Callable[[], tuple[bytes]]:
    """Return what makes the file of a register, each time that it is called; its content may be large."""
    import sqlite3  # noqa: PLC0415, TID251 - in memory only, and of no use to runs that issue nothing

    # In one piece of memory, which need not be put together before it is copied.
    database = sqlite3.connect("file:register?vfs=memdb", uri=True)
    with database:
        database.execute(f"PRAGMA application_id = {_APPLICATION}")
        database.execute(f"PRAGMA user_version = {_VERSION}")
        for table, kind in _TABLES.items():
            columns = (f"{name} {_column(name, type_)[0]}" for name, type_ in kind.__annotations__.items())
            database.execute(f"CREATE TABLE {table} (number INTEGER PRIMARY KEY, {', '.join(columns)})")
        database.execute(f"CREATE UNIQUE INDEX issued ON certificates (issuer, {_SERIAL})")
        database.execute("CREATE TABLE lists (issuer TEXT PRIMARY KEY, number INTEGER NOT NULL)")
        database.execute("CREATE TABLE bundles (name TEXT PRIMARY KEY, number INTEGER NOT NULL)")
        database.execute("CREATE TABLE history (is_whole INTEGER NOT NULL)")
        entries = zip(_TABLES.items(), (register.certificates.values(), register.rights), strict=True)
        for (table, kind), rows in entries:
            names = kind.__annotations__
            insert = f"INSERT INTO {table} ({', '.join(names)}) VALUES ({', '.join('?' * len(names))})"  # noqa: S608 - constants
            stored = (_stored(name, type_, [getattr(each, name) for each in rows]) for name, type_ in names.items())
            database.executemany(insert, zip(*stored, strict=True))
        for table, numbers in zip(_NUMBERED, (register.numbers, register.bundles), strict=True):
            database.executemany(f"INSERT INTO {table} VALUES (?, ?)", sorted(numbers.items()))  # noqa: S608 - constants
        database.execute("INSERT INTO history VALUES (?)", (int(register.is_whole),))

    def made() -> tuple[bytes]:
        return (database.serialize(),)

    weakref.finalize(made, database.close)
    return made


def _stored(name: str, type_: str, values: Sequence[Any]) -> Sequence[Any]:
    """Return the column of a field from its values; the reverse of :func:`_values`."""
    if name == _SERIAL:
        return [f"{each:x}" for each in values]
    if "datetime" not in type_:
        return values
    return [each and _isoformat(each) for each in values]


_isoformat = functools.lru_cache(maxsize=256)(datetime.isoformat)  # many were issued at once


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
