# SPDX-License-Identifier: Apache-2.0
"""The file of the register: the same data comes back, and what is damaged is refused with one line."""

from __future__ import annotations

import contextlib
import sqlite3
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import pytest
from hypothesis import given, strategies as st

from comarmor.errors import Origin
from keymint.errors import KeymintError
from keymint.life.register import REASONS, IssuedCertificate, Register, loaded_register, register_content

WHERE = Origin("private/register.sqlite3")
moments = st.datetimes(datetime(1950, 1, 1), datetime(9999, 12, 31), timezones=st.just(UTC))  # noqa: DTZ001 - bounds
texts = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=20)
revocations = st.one_of(st.tuples(st.none(), st.just("")), st.tuples(moments, st.sampled_from(REASONS)))


@st.composite
def entries(draw: st.DrawFn) -> IssuedCertificate:
    revoked, reason = draw(revocations)
    return IssuedCertificate(
        draw(texts), draw(st.integers(1, 2**159)), draw(texts), draw(texts), draw(st.integers(0, 10**9)),
        draw(moments), draw(moments), draw(texts), draw(texts), revoked, reason, draw(st.none() | moments),
    )  # fmt: skip


def register_file(register: Register) -> bytes:
    return b"".join(register_content(register)())


numbers = st.dictionaries(texts, st.integers(1, 2**40), max_size=3)


@given(st.lists(entries(), max_size=5), numbers, numbers)
def test_round_trip(issued: list[IssuedCertificate], lists: dict[str, int], bundles: dict[str, int]) -> None:
    register = Register({(each.issuer, each.serial): each for each in issued}, lists, bundles)
    content = register_file(register)
    read = loaded_register(content, WHERE)
    assert read == register
    assert list(read.certificates) == list(register.certificates)
    assert register_file(read) == content


NOW = datetime(2027, 1, 1, tzinfo=UTC)
ONE = IssuedCertificate("a" * 64, 7, "ca", "talker", 0, NOW, NOW, "b" * 64, issued=NOW)
FILE = register_file(Register().with_issued([ONE]).with_number(ONE.issuer, 3))


def changed(statement: str) -> bytes:
    with contextlib.closing(sqlite3.connect(":memory:")) as connection:
        connection.deserialize(FILE)
        connection.execute(statement)
        connection.commit()
        return connection.serialize()


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"not a database",
        FILE[:100],
        FILE[:-4096],
        changed("UPDATE certificates SET serial = 'x'"),
        changed("UPDATE certificates SET generation = -1"),
        changed("UPDATE certificates SET not_after = '2027-01-01T00:00:00'"),
        changed("UPDATE certificates SET not_after = 'tomorrow'"),
        changed("UPDATE certificates SET reason = 'retired'"),
        changed("UPDATE certificates SET revoked = not_after"),
        changed("UPDATE certificates SET revoked = not_after, reason = 'stolen'"),
        changed("UPDATE lists SET number = -3"),
        changed("UPDATE lists SET number = 'many'"),
        changed("DROP TABLE bundles"),
        changed("ALTER TABLE certificates DROP COLUMN rights"),
    ],
)
def test_a_damaged_file(content: bytes) -> None:
    with pytest.raises(KeymintError) as caught:
        loaded_register(content, WHERE)
    (found,) = caught.value.diagnostics
    assert (found.code, found.where) in {("register-damaged", WHERE), ("register-version", WHERE)}


def test_a_tool_that_looked_into_it_may_leave_its_mode(tmp_path: Path) -> None:
    path = tmp_path / "register.sqlite3"
    register = Register({}, {"ca": 7}, {})
    path.write_bytes(register_file(register))
    with contextlib.closing(sqlite3.connect(path)) as opened:
        assert opened.execute("PRAGMA journal_mode = wal").fetchone() == ("wal",)
    assert path.read_bytes() != register_file(register)
    assert loaded_register(path.read_bytes(), WHERE) == register


def test_a_file_without_the_time_of_issue_is_read() -> None:
    with contextlib.closing(sqlite3.connect(":memory:")) as connection:
        connection.deserialize(changed("PRAGMA user_version = 2"))
        connection.execute("ALTER TABLE certificates DROP COLUMN issued")
        content = connection.serialize()
    assert loaded_register(content, WHERE).certificates[ONE.issuer, ONE.serial] == replace(ONE, issued=None)


def test_a_later_version() -> None:
    with pytest.raises(KeymintError, match="version 4, expected 3"):
        loaded_register(changed("PRAGMA user_version = 4"), WHERE)


@given(st.integers(0, len(FILE) - 1), st.integers(1, 255))
def test_no_byte_makes_it_fail_in_another_way(position: int, difference: int) -> None:
    damaged = bytearray(FILE)
    damaged[position] ^= difference
    with contextlib.suppress(KeymintError):
        loaded_register(bytes(damaged), WHERE)
