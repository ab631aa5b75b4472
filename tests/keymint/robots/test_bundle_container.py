# SPDX-License-Identifier: Apache-2.0
"""An archive has one form; every other is refused."""

from __future__ import annotations

import io
import subprocess
import tarfile
import tracemalloc
from pathlib import Path

import pytest
from hypothesis import given, strategies as st

from comarmor.errors import Origin
from keymint.errors import KeymintError
from keymint.robots import bundle

from .hostile_archives import ARCHIVES, KEPT

WHERE = Origin("a.tar")
NAMES = st.from_regex(bundle.NAME.pattern, fullmatch=True)


def refused(content: bytes) -> str:
    with pytest.raises(KeymintError) as error:
        bundle.unpack(content, WHERE)
    [diagnostic] = error.value.diagnostics
    assert (diagnostic.code, diagnostic.where) == ("bundle-form", WHERE)
    return diagnostic.message


def archive(*members: tuple[tarfile.TarInfo, bytes], form: int = tarfile.USTAR_FORMAT, mode: str = "w") -> bytes:
    content = io.BytesIO()
    with tarfile.open(fileobj=content, mode=mode, format=form) as written:
        for header, data in members:
            written.addfile(header, io.BytesIO(data))
    return content.getvalue()


def member(name: str, data: bytes = b"x", **values: object) -> tuple[tarfile.TarInfo, bytes]:
    header = tarfile.TarInfo(name)
    header.size, header.mode = len(data), 0o600
    for key, value in values.items():
        setattr(header, key, value)
    return header, data


@given(st.dictionaries(NAMES, st.binary(max_size=2000), max_size=6))
def test_what_is_packed_is_unpacked(members: dict[str, bytes]) -> None:
    assert bundle.unpack(bundle.pack(members), WHERE) == members


@given(st.binary(max_size=4000))
def test_garbage_is_refused(content: bytes) -> None:
    refused(content)


@given(st.integers(0, 10_239), st.integers(1, 255))
def test_an_altered_byte_is_refused_or_in_a_file(at: int, change: int) -> None:
    members = {"a.pem": b"some text", "b": b"x" * 700}
    content = bytearray(bundle.pack(members))
    content[at] ^= change
    try:
        changed = bundle.unpack(bytes(content), WHERE)
    except KeymintError:
        return
    assert changed != members


@pytest.mark.parametrize("size", [0, 1, 511, 512, 513, 1024, 5000, 10_239])
def test_a_truncated_archive_is_refused(size: int) -> None:
    refused(bundle.pack({"a.pem": b"some text", "b": b"x" * 700})[:size])


def test_our_own_form_is_accepted() -> None:
    assert bundle.unpack(archive(member("a"), member("b")), WHERE) == {"a": b"x", "b": b"x"}


HOSTILE = {
    "above": archive(member("../a")),
    "absolute": archive(member("/etc/passwd")),
    "in a folder": archive(member("a/b")),
    "hidden": archive(member(".bashrc")),
    "empty name": archive(member("")),
    "long name": archive(member("a" * 101), form=tarfile.GNU_FORMAT),
    "in another order": archive(member("b"), member("a")),
    "twice": archive(member("a"), member("a")),
    "a symbolic link": archive(member("a", b"", type=tarfile.SYMTYPE, linkname="/etc/passwd")),
    "a hard link": archive(member("a", b"", type=tarfile.LNKTYPE, linkname="b")),
    "a device": archive(member("a", b"", type=tarfile.CHRTYPE)),
    "a fifo": archive(member("a", b"", type=tarfile.FIFOTYPE)),
    "a folder": archive(member("a", b"", type=tarfile.DIRTYPE)),
    "sparse": archive(member("a", b"", type=tarfile.GNUTYPE_SPARSE)),
    "pax headers": archive(member("a", b"x", pax_headers={"path": "../b"}), form=tarfile.PAX_FORMAT),
    "another mode": archive(member("a", mode=0o4755)),
    "a time": archive(member("a", mtime=1)),
    "a user": archive(member("a", uid=1000)),
    "a user's name": archive(member("a", uname="root")),
    "compressed": archive(member("a"), mode="w:gz"),
    "many": archive(*(member(f"a{number}") for number in range(65))),
    "something behind": bundle.pack({"a": b"x"}) + b"\0" * 10_240,
    "two archives": bundle.pack({"a": b"x"}) * 2,
    "large": b"\0" * (bundle.MAX_BYTES + 1),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_what_no_bundle_has_is_refused(name: str) -> None:
    refused(HOSTILE[name])


@pytest.mark.parametrize("name", ARCHIVES)
def test_no_header_makes_the_reader_take_more_than_the_file(name: str) -> None:
    content = ARCHIVES[name]()
    tracemalloc.start()
    try:
        if name in KEPT:
            assert bundle.unpack(content, WHERE) == KEPT[name]
        else:
            refused(content)
        assert tracemalloc.get_traced_memory()[1] <= 3 * bundle.MAX_BYTES
    finally:
        tracemalloc.stop()


def test_a_compressed_bomb_is_as_small_as_it_was_sent() -> None:
    assert len(ARCHIVES["GNU-sparse"]()) < 50_000


def test_too_much_cannot_be_packed() -> None:
    for members in (
        {"../a": b""},
        {f"a{number}": b"" for number in range(65)},
        {"a": b"x" * bundle.MAX_BYTES},
    ):
        with pytest.raises(ValueError, match="of a bundle"):
            bundle.pack(members)


def test_tar_lists_it(tmp_path: Path) -> None:
    (tmp_path / "a.tar").write_bytes(bundle.pack({"cert.pem": b"x", "key.pem": b"y"}))
    shown = subprocess.run(["tar", "-tvf", "a.tar"], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert [line.split()[0] for line in shown.stdout.splitlines()] == ["-rw-------"] * 2
