# SPDX-License-Identifier: Apache-2.0
"""Keys in tokens, on real vendors: authorities whose keys lie in SoftHSM, and a participant whose own key does."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat
from keymint_ros import package_type
from keymint_ros2_dds.decision.semantics import CYCLONEDDS_0_10, FASTDDS_2_9
from keymint_ros2_dds.transports.enclave_model import EnclaveModel
from keymint_ros2_dds.vendors.participants import RefusedError, System, Vendor

from keymint.api import Environment, InstalledEnclave, Issuance, KeySpec
from keymint.pki.tokens.token_sessions import PIN_VARIABLE, Tokens
from tests.conftest import CHECKOUT
from tests.softhsm import PIN, SoftHsm

from .conftest import on_each_cyclonedds, on_each_fastdds

pytestmark = pytest.mark.softhsm
POLICY = CHECKOUT / "templates/keymint_ros/comarmor.d/talker_listener.xml"
TOPIC = "rt/chatter"
ROBOT_PIN = "FASTDDS_PKCS11_PIN"
"""With which Fast DDS logs in where the URI has no PIN."""


def keymint(folder: Path, *arguments: str | Path, fails: str = "") -> str:
    """Run the command in a process of its own, with the clock of the machine, which vendors use too."""
    searched = os.pathsep.join(str(Path(entry).resolve()) for entry in sys.path if entry)
    environment = {**os.environ, "PYTHONPATH": searched, PIN_VARIABLE: PIN}
    environment.pop("SOURCE_DATE_EPOCH", None)
    command = [sys.executable, "-m", "keymint", *arguments]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert (fails in done.stderr) if fails else True, done.stderr
    assert done.returncode == (1 if fails else 0), (command, done.stdout, done.stderr)
    return done.stdout + done.stderr


def exchange(vendor: Vendor, install: Path) -> None:
    """Let the talker send the listener a sample."""
    enclaves = install / "enclaves"
    with System(vendor) as system:
        reader = system.open(enclaves / "listener").edge("subscribe", TOPIC)
        writer = system.open(enclaves / "talker").edge("publish", TOPIC)
        assert arrives(writer, reader)


def arrives(writer, reader) -> bool:
    for _ in range(30):
        writer.write("hello")
        if reader.read(1.0) == "hello":
            return True
    return False


def with_keys(path: Path, keys: Mapping[str, str]) -> None:
    """Name keys of authorities in the profile."""
    text = path.read_text()
    for name, uri in keys.items():
        text = text.replace(f'<authority name="{name}">', f'<authority name="{name}"><key><pkcs11>{uri}</pkcs11></key>')
    path.write_text(text)


def test_authorities_in_a_token(vendor: Vendor, tmp_path: Path, softhsm: SoftHsm) -> None:
    keymint(tmp_path, "init", "ws", "--policy", POLICY)
    ws = tmp_path / "ws"
    for file in (*(ws / "private").glob("*.pem"), *(ws / "public").glob("*.pem")):
        file.unlink()
    names = ("identity_ca", "permissions_ca")
    with_keys(
        ws / "profile/authorities.xml",
        {name: softhsm.make_key(name, f"0{number}") for number, name in enumerate(names)},
    )
    keymint(ws, "provision", POLICY)
    assert not [*(ws / "private").glob("*.pem")]
    assert "no findings" in keymint(ws, "check")
    exchange(vendor, ws / "install")


@pytest.fixture
def robot(tmp_path: Path, softhsm: SoftHsm) -> Path:
    """A workspace whose talker has its key in a token; the listener has its own in a file."""
    keymint(tmp_path, "provision", POLICY, "-w", "ws")
    ws = tmp_path / "ws"
    uri = softhsm.make_key("talker")
    tokens = Tokens({PIN_VARIABLE: PIN})
    public = tokens.public_key(KeySpec("ec", "SECP256R1", uri=uri))
    tokens.close()
    document = ws / "src/talker/identities.xml"
    document.write_text(document.read_text().replace("<identity/>", identity(uri)))
    keymint(ws, "build", fails="only Fast DDS reads key.p11")
    manifest = ws / "profile/keymint_profile.xml"
    manifest.write_text(manifest.read_text().replace("</profile>", "<exceptions><token_keys/></exceptions></profile>"))
    keymint(ws, "build")
    assert "no certificate is issued" in keymint(ws, "install")
    assert not (ws / "install/enclaves/talker/key.p11").exists()
    pem = public.public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo)
    for name, content in package_type.with_issuance(Issuance(public_key=pem)).items():
        (ws / "src/talker" / name).write_bytes(content)
    assert "the profile accepts it" in keymint(ws, "build", "-v")
    keymint(ws, "install")
    (ws / "private/identities/talker/key.pem").unlink()  # nothing uses it any more
    return ws


def identity(uri: str) -> str:
    return f"<identity><key><pkcs11>{uri}</pkcs11></key></identity>"


@on_each_fastdds
def test_a_participant_with_its_key_in_a_token(vendor: Vendor, robot: Path) -> None:
    enclave = robot / "install/enclaves/talker"
    assert (enclave / "key.p11").read_text() == "pkcs11:token=ca;object=talker\n"
    assert not (enclave / "key.pem").exists()
    assert "no findings" in keymint(robot, "check")
    keymint(robot, "prove")
    with_pin = replace(vendor, environment={**os.environ, **vendor.environment, ROBOT_PIN: PIN})
    exchange(with_pin, robot / "install")
    wrong = replace(vendor, environment={**os.environ, **vendor.environment, ROBOT_PIN: "wrong-secret"})
    with System(wrong) as system, pytest.raises(RefusedError):
        system.open(enclave)


@on_each_fastdds
def test_the_pin_of_a_participant_in_a_file(vendor: Vendor, robot: Path, tmp_path: Path) -> None:
    pin = tmp_path / "robot.pin"
    pin.write_text(PIN)
    pin.chmod(0o600)
    document = robot / "src/talker/identities.xml"
    document.write_text(re.sub("(object=talker)", rf"\1?pin-source=file:{pin}", document.read_text()))
    keymint(robot, "build")
    keymint(robot, "install")
    exchange(replace(vendor, environment={**os.environ, **vendor.environment}), robot / "install")


@on_each_cyclonedds
def test_cyclone_dds_starts_without_such_a_key_not_at_all(vendor: Vendor, robot: Path) -> None:
    enclave = robot / "install/enclaves/talker"
    with System(vendor) as system, pytest.raises(RefusedError):
        system.open(enclave)
    model = EnclaveModel(
        InstalledEnclave("/talker", enclave, "jazzy", robot / "install"), Environment(datetime.now(UTC), robot), 0
    )
    assert "key.p11 is not read" in model.unauthenticated(CYCLONEDDS_0_10)
    assert not model.unauthenticated(FASTDDS_2_9)
