# SPDX-License-Identifier: Apache-2.0
"""``keymint.client``: one enclave at a time, from programs, also from several at the same time."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from collections.abc import Callable
from datetime import timedelta
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

from keymint.client import Client, KeymintError, Threshold
from tests.conftest import CHECKOUT, NOW, snapshot
from tests.effort import FULL

POLICY = """\
<profiles>
  <profile name="cameras">
    <attachment>/robot*/camera</attachment>
    <ros_topic qualifier="ALLOW"><attachment>/image</attachment><permissions><ros_publish/></permissions></ros_topic>
  </profile>
</profiles>
"""
PROCESSES, ENCLAVES = (8, 100) if FULL else (3, 4)


@pytest.fixture
def fleet(keymint, tmp_path: Path) -> Path:
    (tmp_path / "fleet.xml").write_text(POLICY)
    assert keymint("init", "ws", "--policy", "fleet.xml").code == 0
    return tmp_path / "ws"


def serial(folder: Path) -> int:
    return x509.load_pem_x509_certificate((folder / "cert.pem").read_bytes()).serial_number


def test_an_enclave_that_the_policy_names_by_a_wildcard_only(fleet: Path, keymint) -> None:
    client = Client(fleet)
    enclave = client.provision("/robot7/camera")
    assert (enclave.subject, enclave.changed, enclave.keystore) == ("/robot7/camera", True, fleet / "install")
    assert (enclave.folder / "permissions.p7s").is_file()
    for path in enclave.folder.iterdir():
        assert path.stat().st_mode & 0o777 == (0o600 if path.name == "key.pem" else 0o644)
    before = snapshot(fleet / "install")
    assert not client.provision("robot7/camera").changed
    assert snapshot(fleet / "install") == before
    assert keymint("check", cwd=fleet).code == 0
    assert keymint("prove", cwd=fleet).code == 0


def test_a_changed_policy_is_read_again(fleet: Path) -> None:
    client = Client(fleet)
    client.provision("/robot1/camera")
    policy = fleet.parent / "fleet.xml"
    policy.write_text(policy.read_text().replace("/image", "/picture"))
    enclave = client.provision("/robot1/camera")
    assert enclave.changed
    assert "rt/picture" in (enclave.folder / "permissions.xml").read_text()
    assert [each.code for each in enclave.diagnostics] == ["rights-outlive"]


def test_revoked(fleet: Path) -> None:
    client = Client(fleet)
    first, second = (client.provision(f"/robot{number}/camera") for number in (1, 2))
    old = serial(first.folder)
    again = client.revoke("/robot1/camera", reason="superseded")
    assert {each.subject for each in again} == {"/robot1/camera", "/robot2/camera"}
    crl = x509.load_pem_x509_crl((second.folder / "crl.pem").read_bytes())
    assert [each.serial_number for each in crl] == [old]
    client.revoke("/robot1/camera", reason="key-compromise")
    assert not first.folder.exists()
    with pytest.raises(KeymintError, match="the certificate of /robot1/camera was revoked") as caught:
        client.provision("/robot1/camera")
    assert caught.value.diagnostics[0].code == "identity-revoked"


def test_renewed(fleet: Path, keymint, monkeypatch: pytest.MonkeyPatch) -> None:
    client = Client(fleet)
    first, second = (client.provision(f"/robot{number}/camera") for number in (1, 2))
    old = serial(first.folder), serial(second.folder)
    assert client.renew() == ()
    monkeypatch.setenv("SOURCE_DATE_EPOCH", str(NOW + 2 * 86400))
    (renewed,) = client.renew("/robot1/camera")
    assert (renewed.subject, renewed.changed) == ("/robot1/camera", True)
    assert serial(first.folder) != old[0]
    monkeypatch.setenv("SOURCE_DATE_EPOCH", str(NOW + 300 * 86400))
    assert {each.subject for each in client.renew()} == {"/robot1/camera", "/robot2/camera"}
    assert {each.subject for each in client.renew(threshold=Threshold(left=timedelta(days=30)))} == set()
    key = (first.folder / "key.pem").read_bytes()
    client.renew("/robot1/camera", rekey=True)
    assert keymint("check", cwd=fleet).code == 0
    assert (first.folder / "key.pem").read_bytes() != key


def test_the_workspace_stays_the_same_in_another_folder(fleet: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(fleet.parent)
    client = Client(fleet.name)
    monkeypatch.chdir("/")
    assert client.provision("/robot1/camera").keystore == fleet / "install"
    assert [each.subject for each in client.renew("/robot1/camera", rekey=True)] == ["/robot1/camera"]
    assert client.bundle("/robot1/camera", fleet.parent).parent == fleet.parent


def test_bundled(fleet: Path, keymint) -> None:
    client = Client(fleet)
    enclave = client.provision("/robot1/camera")
    (fleet.parent / "out").mkdir()
    path = client.bundle("/robot1/camera", fleet.parent / "out")
    assert path.stat().st_mode & 0o777 == 0o600
    authority = x509.load_pem_x509_certificate((fleet / "public/identity_ca.cert.pem").read_bytes())
    key = authority.public_key().public_bytes(Encoding.DER, PublicFormat.SubjectPublicKeyInfo)
    fingerprint = hashlib.sha256(key).hexdigest()
    robot = fleet.parent / "robot"
    accepted = keymint("accept", path, "--folder", robot, "--authority-fingerprint", fingerprint, "--new")
    assert accepted.code == 0, accepted.err
    there = {file.name: file.read_bytes() for file in (robot / "enclaves/robot1/camera").iterdir() if file.is_file()}
    own = {file.name: file.read_bytes() for file in enclave.folder.iterdir()}
    assert own.items() <= there.items()


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda folder: Client(folder / "nowhere"), "workspace"),
        (lambda folder: Client(folder / "ws").provision("/../x"), "not a legal name"),
        (lambda folder: Client(folder / "ws").provision("/drone"), "drone"),
        (lambda folder: Client(folder / "ws").revoke("/robot1/camera", reason="retired"), "never had a certificate"),
    ],
)
def test_errors_change_nothing(fleet: Path, call: Callable[[Path], object], message: str) -> None:
    before = snapshot(fleet)
    with pytest.raises(KeymintError, match=message):
        call(fleet.parent)
    assert snapshot(fleet) == before


def test_processes_at_the_same_time_lose_nothing(fleet: Path, keymint) -> None:
    program = (
        "import sys; from keymint.client import Client; client = Client(sys.argv[1])\n"
        "for number in range(int(sys.argv[3])): client.provision(f'/robot{sys.argv[2]}_{number}/camera')"
    )
    running = [
        subprocess.Popen(
            [sys.executable, "-c", program, str(fleet), str(process), str(ENCLAVES)],
            cwd=CHECKOUT, env={**os.environ, "PYTHONPATH": str(CHECKOUT)}, stderr=subprocess.PIPE, text=True,
        )
        for process in range(PROCESSES)
    ]  # fmt: skip
    for each in running:
        _, err = each.communicate(timeout=1800)
        assert (each.returncode, err) == (0, "")
    issued = keymint("issued", "--json", cwd=fleet).document["result"]["certificates"]
    names = {f"/robot{process}_{number}/camera" for process in range(PROCESSES) for number in range(ENCLAVES)}
    assert {each["subject"] for each in issued} == names
    assert len({each["serial"] for each in issued}) == len(issued) == PROCESSES * ENCLAVES
    for each in issued:
        assert serial(fleet / f"install/enclaves{each['subject']}") == int(each["serial"], 16)
    assert keymint("check", cwd=fleet).code == 0
