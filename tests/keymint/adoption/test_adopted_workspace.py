# SPDX-License-Identifier: Apache-2.0
"""What the plan of an adoption refuses before anything is written."""

from __future__ import annotations

import shutil
from pathlib import Path

from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.serialization import (
    BestAvailableEncryption,
    Encoding,
    NoEncryption,
    PrivateFormat,
    pkcs12,
)

from tests import sros2_keystore
from tests.keymint.commands.exchange.test_adopt import POLICY, made


def test_a_document_that_the_sources_cannot_mean(keymint, tmp_path: Path, monkeypatch) -> None:
    """A wrong comparison would be found by the build, which is planned before anything is written."""
    made(tmp_path / "ks")
    (tmp_path / "policy.xml").write_text(POLICY)
    monkeypatch.setattr("keymint_ros2_dds.keystores.foreign_documents.not_kept", lambda *_: "it is something else")
    outcome = keymint("adopt", "ks", "policy.xml", "--apply", "-w", "ws")
    assert outcome.code == 1
    assert "cannot be kept as it is signed: it is something else" in outcome.err
    assert not (tmp_path / "ws").exists()


def test_a_file_that_the_installation_would_change(keymint, tmp_path: Path) -> None:
    """Outside of the enclaves lies the governance of another keystore, which nobody reads."""
    keystore = made(tmp_path / "ks")
    (tmp_path / "policy.xml").write_text(POLICY)
    (keystore / "enclaves/governance.xml").write_bytes(sros2_keystore.governance(9))
    outcome = keymint("adopt", "ks", "policy.xml", "--apply", "-w", "ws")
    assert outcome.code == 1
    assert "ks/enclaves/governance.xml: error: would be changed by 'keymint install -w ws'" in outcome.err
    assert not (tmp_path / "ws").exists()


def test_what_is_in_the_keystore_beside_it_stays_where_it_is(keymint, tmp_path: Path) -> None:
    keystore = made(tmp_path / "ks")
    (tmp_path / "policy.xml").write_text(POLICY)
    (keystore / "enclaves/notes.txt").write_text("mine")
    (keystore / "notes.txt").write_text("mine")
    (keystore / "enclaves/ca.key.pem").write_bytes((keystore / "private/ca.key.pem").read_bytes())
    (keystore / "enclaves/ca.key.pem").chmod(0o600)
    assert keymint("adopt", "ks", "policy.xml", "--apply", "-w", "ws").code == 0
    install = tmp_path / "ws/install"
    assert (install / "enclaves/notes.txt").read_text() == "mine"
    assert not (install / "notes.txt").exists()
    assert not (install / "enclaves/ca.key.pem").exists()  # a private key of an authority never reaches robots


def test_a_binary_file_that_only_its_owner_reads_stays_private(keymint, tmp_path: Path) -> None:
    """It may be a key in a form that is not PEM; certificates and documents are 0644 whatever their mode was."""
    keystore = made(tmp_path / "ks")
    (tmp_path / "policy.xml").write_text(POLICY)
    for name, mode in (("own.p12", 0o600), ("logo.png", 0o644)):
        (keystore / "enclaves" / name).write_bytes(b"\x30\x82\x00\xff")
        (keystore / "enclaves" / name).chmod(mode)
    (keystore / "enclaves/governance.xml").chmod(0o600)
    assert keymint("adopt", "ks", "policy.xml", "--apply", "-w", "ws").code == 0
    enclaves = tmp_path / "ws/install/enclaves"
    found = {name: (enclaves / name).stat().st_mode & 0o777 for name in ("own.p12", "logo.png", "governance.xml")}
    assert found == {"own.p12": 0o600, "logo.png": 0o644, "governance.xml": 0o644}


def test_no_copy_of_an_authoritys_key_reaches_robots(keymint, tmp_path: Path) -> None:
    """In any form, under any name: PEM, DER (RFC 5958, RFC 5915), beside a certificate, behind a link."""
    keystore = made(tmp_path / "ks")
    (tmp_path / "policy.xml").write_text(POLICY)
    pem = (keystore / "private/ca.key.pem").read_bytes()
    key = serialization.load_pem_private_key(pem, None)
    forms = {
        "first.key.pem": pem,
        "talker/second.key.pem": pem + b"\n",
        "with_certificate.pem": (keystore / "public/ca.cert.pem").read_bytes() + pem,
        "pkcs8": key.private_bytes(Encoding.DER, PrivateFormat.PKCS8, NoEncryption()) + b"\n",
        "talker/sec1.der": key.private_bytes(Encoding.DER, PrivateFormat.TraditionalOpenSSL, NoEncryption()),
    }
    for name, content in forms.items():
        (keystore / "enclaves" / name).write_bytes(content)
        (keystore / "enclaves" / name).chmod(0o600)
    (keystore / "public/link.key.pem").symlink_to("../private/ca.key.pem")
    outcome = keymint("adopt", "ks", "policy.xml", "--apply", "-w", "ws")
    assert outcome.code == 0, outcome.err
    assert all(
        f"ks/enclaves/{name}: warning: is the private key of the authority 'ca'" in outcome.err for name in forms
    )
    assert (tmp_path / "ws/private/ca.key.pem").read_bytes() in {pem, pem + b"\n"}
    install = {str(path.relative_to(tmp_path / "ws/install")) for path in (tmp_path / "ws/install").rglob("*")}
    assert not {*install} & {*(f"enclaves/{name}" for name in forms), "public/link.key.pem"}


def test_an_authoritys_key_in_der_alone(keymint, tmp_path: Path) -> None:
    keystore = made(tmp_path / "ks")
    (tmp_path / "policy.xml").write_text(POLICY)
    for path in (keystore / "private").iterdir():
        if not path.is_symlink():
            pem = path.read_bytes()
            key = serialization.load_pem_private_key(pem, None)
            (keystore / "enclaves/ca.der").write_bytes(
                key.private_bytes(Encoding.DER, PrivateFormat.PKCS8, NoEncryption())
            )
    shutil.rmtree(keystore / "private")
    assert keymint("adopt", "ks", "policy.xml", "--apply", "-w", "ws").code == 0
    assert (tmp_path / "ws/private/ca.key.pem").read_bytes() == pem
    assert not (tmp_path / "ws/install/enclaves/ca.der").exists()


def test_a_key_that_nobody_can_read_is_the_owners_decision(keymint, tmp_path: Path) -> None:
    keystore = made(tmp_path / "ks")
    (tmp_path / "policy.xml").write_text(POLICY)
    key = serialization.load_pem_private_key((keystore / "private/ca.key.pem").read_bytes(), None)
    password = BestAvailableEncryption(b"secret")
    forms = {
        "ca.p12": pkcs12.serialize_key_and_certificates(None, key, None, None, password),
        "talker/ca.der": key.private_bytes(Encoding.DER, PrivateFormat.PKCS8, password),
        "talker/ca.pem": key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, password),
    }
    for name, content in forms.items():
        (keystore / "enclaves" / name).write_bytes(content)
    (keystore / "private/ca.p12").write_bytes(forms["ca.p12"])  # nothing takes it from there
    outcome = keymint("adopt", "ks", "policy.xml", "--apply", "-w", "ws", "--json")
    found = {each["file"]: each["code"] for each in outcome.document["diagnostics"] if each["severity"] == "error"}
    assert found == {f"ks/enclaves/{name}": "adopt-key-sealed" for name in forms}
    assert not (tmp_path / "ws").exists()


def test_an_enclave_with_the_key_of_its_authority(keymint, tmp_path: Path) -> None:
    keystore = made(tmp_path / "ks")
    (keystore / "enclaves/talker/key.pem").write_bytes((keystore / "private/ca.key.pem").read_bytes())
    outcome = keymint("adopt", "ks", "--json")
    assert "adopt-key-shared" in outcome.codes()


def test_a_link_to_what_robots_do_not_get_becomes_the_file(keymint, tmp_path: Path) -> None:
    keystore = made(tmp_path / "ks")
    (tmp_path / "policy.xml").write_text(POLICY)
    key = keystore / "enclaves/talker/key.pem"
    content = key.read_bytes()
    key.rename(keystore / "private/talker.key.pem")
    key.symlink_to("../../private/talker.key.pem")
    assert keymint("adopt", "ks", "policy.xml", "--apply", "-w", "ws").code == 0
    installed = tmp_path / "ws/install/enclaves/talker/key.pem"
    assert (installed.is_symlink(), installed.read_bytes(), installed.stat().st_mode & 0o777) == (False, content, 0o600)
    assert keymint("install", "-w", "ws").code == 0


def test_a_key_in_der_among_single_files_is_none_that_participants_read(keymint, tmp_path: Path) -> None:
    keystore = made(tmp_path / "ks", layout="rti")
    pem = keystore / "cert/talker_key.pem"
    key = serialization.load_pem_private_key(pem.read_bytes(), None)
    (keystore / "a.der").write_bytes(key.private_bytes(Encoding.DER, PrivateFormat.PKCS8, NoEncryption()))
    found = {each["subject"]: each["key"] for each in keymint("adopt", "ks", "--json").document["result"]["enclaves"]}
    assert found == {"/robot1/listener": "matches", "/talker": "matches"}
    pem.unlink()
    outcome = keymint("adopt", "ks", "--apply", "-w", "ws")
    assert outcome.code == 0, outcome.err
    assert not (tmp_path / "ws/install/enclaves/talker/key.pem").exists()
