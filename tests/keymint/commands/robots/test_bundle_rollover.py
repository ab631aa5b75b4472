# SPDX-License-Identifier: Apache-2.0
"""Enclaves whose key is on their robot, while the key of an authority is replaced: bundles carry every phase."""

from __future__ import annotations

import hashlib
import shutil
from pathlib import Path
from typing import Any

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

from tests.conftest import snapshot


def ran(keymint, *arguments: object) -> dict[str, Any]:
    outcome = keymint(*arguments, "--json")
    assert outcome.code == 0, outcome.out
    result: dict[str, Any] = outcome.document["result"]
    return result


def authorities(folder: Path) -> list[str]:
    """Return the fingerprints of the keys of the authorities that an enclave trusts, in their order."""
    found = x509.load_pem_x509_certificates((folder / "identity_ca.cert.pem").read_bytes())
    spki = [each.public_key().public_bytes(Encoding.DER, PublicFormat.SubjectPublicKeyInfo) for each in found]
    return [hashlib.sha256(each).hexdigest() for each in spki]


def phase(keymint, *more: str) -> None:
    outcome = keymint("authority", "replace", "identity_ca", "-w", "ws", *more)
    assert outcome.code == 0, outcome.err


def deliver(keymint, *more: str, folder: str = "robot", staged: bool = False) -> Any:
    ran(keymint, "bundle", "talker", "-w", "ws", *(["--staged"] if staged else []))
    return keymint("accept", "talker.bundle", "--folder", folder, *more, "--json")


@pytest.fixture
def robot(keymint, ws: Path, tmp_path: Path) -> Path:
    """The folder of an enclave on a robot that made its key."""
    fingerprint = ran(keymint, "request", "talker", "--folder", "robot")["fingerprint"]
    made = ran(keymint, "sign", "talker.request.pem", "-w", "ws", "--fingerprint", f"talker={fingerprint}")
    trust = made["bundles"][0]["authority"]
    ran(keymint, "accept", "talker.bundle", "--folder", "robot", "--authority-fingerprint", trust)
    return tmp_path / "robot/enclaves/talker"


def test_phases_of_an_authority_that_is_trusted_beside_the_next(keymint, robot: Path, ws: Path) -> None:
    [old] = authorities(robot)
    key = (robot / "key.pem").read_bytes()
    phase(keymint, "--vendor", "fastdds")
    of_workspace = ws / "install/enclaves/talker"
    _, new = authorities(of_workspace)
    # The authority in force may not add one: somebody compares the fingerprint of the next key.
    before = snapshot(robot)
    assert deliver(keymint).codes() == ["bundle-authority"]
    assert snapshot(robot) == before
    assert deliver(keymint, "--authority-fingerprint", new).code == 0
    assert authorities(robot) == [old, new]
    phase(keymint, "--phase", "reissue")
    assert deliver(keymint).code == 0
    assert set(authorities(robot)) == {old, new}
    phase(keymint, "--phase", "end")
    assert deliver(keymint).code == 0
    assert authorities(robot) == [new]
    assert (robot / "key.pem").read_bytes() == key
    for file in of_workspace.iterdir():
        assert (robot / file.name).read_bytes() == file.read_bytes()


def test_a_second_keystore(keymint, robot: Path, ws: Path, tmp_path: Path) -> None:
    phase(keymint)
    [old], [new] = authorities(robot), authorities(ws / "install.next/enclaves/talker")
    before = snapshot(tmp_path / "robot")
    shutil.copytree(tmp_path / "robot", tmp_path / "next")
    there = tmp_path / "next/enclaves/talker"
    assert deliver(keymint, folder="next", staged=True).codes() == ["bundle-authority"]
    assert deliver(keymint, "--authority-fingerprint", new, folder="next", staged=True).code == 0
    assert authorities(there) == [new]
    assert snapshot(tmp_path / "robot") == before
    # Until the switch the keystore in force gets its own bundles.
    assert deliver(keymint).code == 0
    assert authorities(robot) == [old]
    phase(keymint, "--phase", "end")
    assert deliver(keymint, folder="next").code == 0
    for file in (ws / "install/enclaves/talker").iterdir():
        assert (there / file.name).read_bytes() == file.read_bytes()


def test_without_a_second_keystore(keymint, ws: Path) -> None:
    outcome = keymint("bundle", "talker", "-w", "ws", "--staged", "--json")
    assert (outcome.code, outcome.codes()) == (1, ["rollover-none"])


def test_a_second_keystore_that_is_not_complete(keymint, ws: Path) -> None:
    phase(keymint)
    (ws / "install.next/enclaves/talker/cert.pem").unlink()
    outcome = keymint("bundle", "talker", "-w", "ws", "--staged", "--json")
    assert (outcome.code, outcome.codes()) == (1, ["rollover-incomplete"])
