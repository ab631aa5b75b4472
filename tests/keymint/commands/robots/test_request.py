# SPDX-License-Identifier: Apache-2.0
"""``keymint request``."""

from __future__ import annotations

import shutil
import stat
from pathlib import Path

import pytest

from comarmor.errors import Origin
from keymint.pki.tokens.token_sessions import PIN_VARIABLE
from keymint.robots import certification_request
from tests.conftest import snapshot
from tests.softhsm import PIN, SoftHsm

WITH_PIN = {PIN_VARIABLE: PIN}


def asked(keymint, *arguments: object, **settings: object) -> dict:
    outcome = keymint("request", *arguments, "--json", **settings)
    assert outcome.code == 0, outcome.out
    return outcome.document["result"]


def test_a_key_and_a_request(keymint, tmp_path: Path) -> None:
    outcome = keymint("request", "/robot1/talker", "--folder", "keystore")
    assert (outcome.code, outcome.err) == (0, "")
    file = tmp_path / "robot1.talker.request.pem"
    read = certification_request.read(file.read_bytes(), Origin("request"))
    assert read.common_name == "/robot1/talker"
    assert f"--fingerprint /robot1/talker={read.fingerprint}" in outcome.out
    key = tmp_path / "keystore/.keymint/requests/robot1/talker/key.pem"
    assert stat.S_IMODE(key.stat().st_mode) == 0o600
    assert stat.S_IMODE(key.parent.stat().st_mode) == 0o700
    assert b"PRIVATE KEY" not in file.read_bytes()
    assert "PRIVATE" not in outcome.out
    assert not (tmp_path / "keystore/enclaves").exists()


def test_a_request_that_waits_is_written_again(keymint, tmp_path: Path) -> None:
    first = asked(keymint, "robot1/talker", "--folder", "keystore", "-o", "first.pem")
    (tmp_path / "first.pem").rename(tmp_path / "second.pem")
    again = asked(keymint, "robot1/talker", "--folder", "keystore", "-o", "first.pem")
    assert again == first
    assert (tmp_path / "first.pem").read_bytes() == (tmp_path / "second.pem").read_bytes()
    unchanged = asked(keymint, "robot1/talker", "--folder", "keystore", "-o", "first.pem")
    assert unchanged["written"] == []


def test_it_is_discarded_on_request_only(keymint, tmp_path: Path) -> None:
    first = asked(keymint, "talker", "--folder", "keystore")
    other = asked(keymint, "talker", "--folder", "keystore", "--discard")
    assert other["fingerprint"] != first["fingerprint"]
    content = (tmp_path / "talker.request.pem").read_bytes()
    assert certification_request.read(content, Origin("request")).fingerprint == other["fingerprint"]


def test_every_request_has_a_nonce_of_its_own(keymint, tmp_path: Path) -> None:
    nonces = set()
    for name in ("a", "b"):
        asked(keymint, name, "--folder", "keystore")
        nonces.add(certification_request.read((tmp_path / f"{name}.request.pem").read_bytes(), Origin("request")).nonce)
    assert len(nonces) == 2


@pytest.mark.parametrize(("kind", "bits"), [("P-256", 256), ("RSA-2048", 2048)])
def test_kinds_of_keys(keymint, tmp_path: Path, kind: str, bits: int) -> None:
    from cryptography import x509

    asked(keymint, "talker", "--folder", "keystore", "--key-type", kind)
    csr = x509.load_pem_x509_csr((tmp_path / "talker.request.pem").read_bytes())
    assert csr.public_key().key_size == bits


def test_the_keystore_of_the_environment(keymint, tmp_path: Path) -> None:
    result = asked(keymint, "talker", env={"ROS_SECURITY_KEYSTORE": str(tmp_path / "there")})
    assert result["keystore"] == "there"
    assert (tmp_path / "there/.keymint/requests/talker/key.pem").exists()


def test_without_any_keystore(keymint, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("ROS_SECURITY_KEYSTORE", raising=False)
    outcome = keymint("request", "talker")
    assert outcome.code == 2
    assert "--folder" in outcome.err


def test_a_bad_name_writes_nothing(keymint, tmp_path: Path) -> None:
    for name in ("/../talker", "a b", "//", ""):
        outcome = keymint("request", name, "--folder", "keystore")
        assert outcome.code == 1, name
        assert len(outcome.err.splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


@pytest.fixture
def robot(keymint, ws: Path, tmp_path: Path) -> Path:
    """The keystore of a robot that was provisioned from the workspace."""
    (ws / "install").rename(tmp_path / "robot")
    return tmp_path / "robot"


def test_an_enclave_keeps_its_key(keymint, robot: Path, tmp_path: Path) -> None:
    before = snapshot(robot / "enclaves")
    result = asked(keymint, "/talker", "--folder", "robot")
    assert result["signed_by_current_key"]
    assert not (robot / ".keymint/requests/talker/key.pem").exists()
    assert snapshot(robot / "enclaves") == before
    read = certification_request.read((tmp_path / "talker.request.pem").read_bytes(), Origin("request"))
    assert (read.fingerprint, read.signer) == (result["fingerprint"], "")


def test_a_new_key_is_vouched_for_by_the_old_one(keymint, robot: Path, tmp_path: Path) -> None:
    old = asked(keymint, "/talker", "--folder", "robot")["fingerprint"]
    refused = keymint("request", "/talker", "--folder", "robot", "--rekey", "--json")
    assert refused.codes() == ["request-waits"]
    result = asked(keymint, "/talker", "--folder", "robot", "--rekey", "--discard")
    read = certification_request.read((tmp_path / "talker.request.pem").read_bytes(), Origin("request"))
    assert read.signer == old != read.fingerprint == result["fingerprint"]
    assert result["signed_by_current_key"]
    assert (robot / ".keymint/requests/talker/key.pem").exists()


def test_a_key_that_cannot_be_read_is_an_error(keymint, robot: Path, tmp_path: Path) -> None:
    (robot / "enclaves/talker/key.pem").write_bytes(b"x")
    outcome = keymint("request", "/talker", "--folder", "robot", "--json")
    assert outcome.codes() == ["key-invalid"]
    assert not (tmp_path / "talker.request.pem").exists()
    assert not (robot / ".keymint/requests").exists()


def test_a_long_name_is_shortened_as_in_certificates(keymint, tmp_path: Path) -> None:
    name = "/".join(["segment_of_a_name"] * 5)
    asked(keymint, name, "--folder", "keystore", "-o", "long.pem")
    read = certification_request.read((tmp_path / "long.pem").read_bytes(), Origin("request"))
    assert read.common_name == "/" + "/".join(["segment_of_a_name"] * 3)


@pytest.mark.softhsm
def test_a_key_in_a_token_signs_its_request(keymint, tmp_path: Path, softhsm: SoftHsm) -> None:
    uri = softhsm.make_key("talker")
    result = asked(keymint, "talker", "--folder", "keystore", "--pkcs11", uri, env=WITH_PIN)
    assert not result["signed_by_current_key"]
    read = certification_request.read((tmp_path / "talker.request.pem").read_bytes(), Origin("request"))
    assert (read.fingerprint, read.signer) == (result["fingerprint"], "")
    assert [file.name for file in (tmp_path / "keystore/.keymint/requests/talker").iterdir()] == ["request.pem"]
    assert asked(keymint, "talker", "--folder", "keystore", "--pkcs11", uri) == {**result, "written": []}


@pytest.mark.softhsm
@pytest.mark.parametrize(
    ("uri", "environment", "code"),
    [
        ("pkcs11:token=ca;object=talker", {}, "token-pin-missing"),
        ("pkcs11:token=ca;object=talker", {PIN_VARIABLE: "wrong-secret"}, "token-pin"),
        ("pkcs11:token=ca;object=other", WITH_PIN, "token-key-missing"),
        ("pkcs11:token=ca", WITH_PIN, "pkcs11-uri"),
    ],
)
def test_a_token_that_cannot_be_used_leaves_nothing(
    keymint, tmp_path: Path, softhsm: SoftHsm, uri: str, environment: dict[str, str], code: str
) -> None:
    softhsm.make_key("talker")
    outcome = keymint("request", "talker", "--folder", "keystore", "--pkcs11", uri, "--json", env=environment)
    assert (outcome.code, outcome.codes()) == (1, [code])
    assert "wrong-secret" not in outcome.out
    assert not (tmp_path / "talker.request.pem").exists()
    assert not (tmp_path / "keystore/.keymint/requests").exists()


@pytest.mark.softhsm
def test_a_robot_whose_key_moves_into_a_token(keymint, ws: Path, tmp_path: Path, softhsm: SoftHsm) -> None:
    shutil.copytree(ws / "install", tmp_path / "robot")
    uri = softhsm.make_key("talker")
    identities, manifest = ws / "src/talker/identities.xml", ws / "profile/keymint_profile.xml"
    named = f"<identity><key><pkcs11>{uri}</pkcs11></key></identity>"
    identities.write_text(identities.read_text().replace("<identity/>", named))
    manifest.write_text(manifest.read_text().replace("</profile>", "<exceptions><token_keys/></exceptions></profile>"))

    def ask(*more: str):
        return keymint("request", "talker", "--folder", "robot", "--pkcs11", uri, "--json", *more, env=WITH_PIN)

    assert ask().codes() == ["key-elsewhere"]  # the enclave has another key, in its file
    result = ask("--rekey").document["result"]
    assert result["signed_by_current_key"]  # by the old one
    outcome = keymint("sign", "talker.request.pem", "-w", "ws")
    assert outcome.code == 0, outcome.err
    assert keymint("accept", "talker.bundle", "--folder", "robot").code == 0
    enclave = tmp_path / "robot/enclaves/talker"
    assert (enclave / "key.p11").read_text() == f"{uri}\n"
    assert not (enclave / "key.pem").exists()
    # Now it is the key of the enclave, and vouches for itself; without the URI nobody knows where it is.
    assert keymint("request", "talker", "--folder", "robot", "--json").codes() == ["key-elsewhere"]
    again = ask().document["result"]
    assert (again["fingerprint"], again["signed_by_current_key"]) == (result["fingerprint"], True)
    assert keymint("sign", "talker.request.pem", "-w", "ws").code == 0
