# SPDX-License-Identifier: Apache-2.0
"""A file from elsewhere that is refused takes at most 200 MB, whoever reads it."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

import pytest

from keymint.robots import bundle
from tests.effort import FULL
from tests.keymint.robots.hostile_archives import ARCHIVES, KEPT

from . import bombs, hostile, peak
from .memory import in_memory

ENCLAVE = "ws/install/enclaves/a"


def _bundles() -> bombs.Bombs:
    large = {"large": lambda: b"\0" * (6 * bundle.MAX_BYTES)}
    return {name: make for name, make in ARCHIVES.items() if name not in KEPT} | large


READERS: Mapping[str, tuple[str, Sequence[str], Callable[[Path], bombs.Bombs]]] = {
    "bundles": ("a.bundle", ("accept", "a.bundle", "--folder", "taken", "--new"), lambda _: _bundles()),
    "requests": ("a.csr", ("sign", "a.csr", "-w", "ws", "-o", "out"), lambda _: bombs.REQUESTS),
    "policies": ("policy.xml", ("lint", "policy.xml"), lambda _: bombs.xml("profiles")),
    "policies to lay out": ("policy.xml", ("fmt", "--check", "policy.xml"), lambda _: bombs.xml("profiles")),
    "policies of SROS2": (
        "foreign.xml", ("import", "foreign.xml", "-o", "imported"), lambda _: bombs.xml("policy", ' version="0.2.0"'),
    ),
    "included files": ("inner.xml", ("lint", "outer.xml"), lambda _: bombs.xml("profile")),
    "tables": ("t.csv", ("lint", "t.csv"), lambda _: bombs.TABLES),
    "databases": ("t.db", ("lint", "t.db"), lambda _: bombs.DATABASES),
    "graphs": ("graph.json", ("learn", "graph.json"), lambda _: bombs.GRAPHS),
    "captures": ("capture", ("discover", "--from", "capture"), lambda _: bombs.GRAPHS | bombs.xml("Participants")),
    "installed permissions": (
        f"{ENCLAVE}/permissions.p7s", ("check", "-w", "ws"),
        lambda place: bombs.signed((place / ENCLAVE / "permissions.p7s").read_bytes()),
    ),
    "permissions of a keystore": (
        f"{ENCLAVE}/permissions.p7s", ("adopt", "ws/install"),
        lambda place: bombs.signed((place / ENCLAVE / "permissions.p7s").read_bytes()),
    ),
    "governance of a keystore": (
        f"{ENCLAVE}/governance.p7s", ("adopt", "ws/install"),
        lambda place: bombs.signed((place / ENCLAVE / "governance.p7s").read_bytes()),
    ),
    "installed certificates": (
        f"{ENCLAVE}/cert.pem", ("check", "-w", "ws"),
        lambda place: bombs.certificates((place / ENCLAVE / "cert.pem").read_bytes()),
    ),
    "certificates of a keystore": (
        f"{ENCLAVE}/cert.pem", ("adopt", "ws/install"),
        lambda place: bombs.certificates((place / ENCLAVE / "cert.pem").read_bytes()),
    ),
    "authorities of a keystore": (
        f"{ENCLAVE}/identity_ca.cert.pem", ("adopt", "ws/install"),
        lambda place: bombs.certificates((place / ENCLAVE / "cert.pem").read_bytes()),
    ),
    "authorities that somebody else issued": (
        "ca.pem", ("authority", "import", "identity_ca", "ca.pem", "-w", "ws"),
        lambda place: bombs.certificates((place / ENCLAVE / "cert.pem").read_bytes()),
    ),
    "installed lists": (f"{ENCLAVE}/crl.pem", ("check", "-w", "ws"), lambda _: bombs.revocation_lists()),
    "lists of a keystore": (f"{ENCLAVE}/crl.pem", ("adopt", "ws/install"), lambda _: bombs.revocation_lists()),
}  # fmt: skip
"""For each reader, the file, the run that reads it, and what makes files that it must refuse."""
SAMPLE = 1


@pytest.fixture(scope="module")
def prepared() -> Iterator[Path]:
    with in_memory() as folder:
        hostile.files(folder)
        include = '<xi:include xmlns:xi="http://www.w3.org/2001/XInclude" href="inner.xml"/>'
        (folder / "outer.xml").write_text(f"<profiles><profile name='a'>{include}</profile></profiles>")
        yield folder


@pytest.mark.parametrize("reader", READERS)
def test_a_file_that_is_refused_takes_little_memory(prepared: Path, tmp_path: Path, reader: str) -> None:
    name, arguments, made = READERS[reader]
    shutil.copytree(prepared, tmp_path, dirs_exist_ok=True, symlinks=True)
    cases = made(tmp_path)
    chosen = list(cases) if FULL else sorted(cases, key=lambda case: hash_of(reader + case))[:SAMPLE]
    os.chdir(tmp_path)
    try:
        for case in chosen:
            (tmp_path / name).unlink(missing_ok=True)
            (tmp_path / "made.db").unlink(missing_ok=True)
            (tmp_path / name).write_bytes(cases[case]())
            ran = peak.run(arguments, tmp_path)
            assert (ran.code in {1, 3}, "internal error" in ran.err) == (True, False), (case, ran)
            assert 0 < ran.peak <= peak.MOST, (case, ran)
    finally:
        os.chdir(prepared.parent)


def hash_of(text: str) -> int:
    """Return a number for a text, the same in each run."""
    return sum(at * ord(char) for at, char in enumerate(text, 1)) % 1009


def test_the_memory_is_measured(tmp_path: Path) -> None:
    (tmp_path / "policy.xml").write_text(hostile.POLICY)
    assert 10 < peak.run(["lint", "policy.xml"], tmp_path).peak < 100
