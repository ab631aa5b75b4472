# SPDX-License-Identifier: Apache-2.0
"""``keymint authority``: show, renew, import and export."""

from __future__ import annotations

import shutil
import stat
import subprocess
from datetime import UTC, datetime
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding

from keymint.pki import keys
from tests.conftest import NOW, snapshot
from tests.keymint.stages.keystores import AUTHORITY_KEYS, CERTIFICATES, ENCLAVES, content, trusted

YEAR = 365 * 86400
LATER = {"SOURCE_DATE_EPOCH": str(NOW + YEAR // 2)}
IDENTITY, PERMISSIONS = "identity_ca", "permissions_ca"


def certificate(path: Path) -> x509.Certificate:
    return x509.load_pem_x509_certificate(path.read_bytes())


def outside(
    subject: str = "Robots of Example", *, lists: bool = True, identifier: bool = True, years: int = 5, ca: bool = True
) -> tuple[bytes, bytes]:
    """Return the certificate and the key, both PEM, of an authority that another tool made."""
    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, subject)])
    usage = x509.KeyUsage(True, False, False, False, False, True, lists, False, False)
    builder = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(datetime(2026, 1, 1, tzinfo=UTC))
        .not_valid_after(datetime(2026 + years, 1, 1, tzinfo=UTC))
        .add_extension(x509.BasicConstraints(ca, None), critical=True)
        .add_extension(usage, critical=True)
    )
    if identifier:
        builder = builder.add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
    pem = builder.sign(key, hashes.SHA256()).public_bytes(Encoding.PEM)
    return pem, keys.to_pem(key)


def openssl_accepts(ws: Path) -> None:
    """Let openssl judge each enclave: its certificate, and its signed documents."""
    for name in ENCLAVES:
        folder = ws / "install/enclaves" / name
        for arguments in (
            ("verify", "-x509_strict", "-CAfile", "identity_ca.cert.pem", "cert.pem"),
            ("smime", "-verify", "-CAfile", "permissions_ca.cert.pem", "-in", "permissions.p7s"),
            ("smime", "-verify", "-CAfile", "permissions_ca.cert.pem", "-in", "governance.p7s"),
        ):
            at = ("-attime", str(NOW))
            command = ["openssl", arguments[0], *at, *arguments[1:]]
            done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
            assert done.returncode == 0, (name, command, done.stderr)


# -- show ------------------------------------------------------------------------------------------------------------


def test_show(keymint, ws: Path) -> None:
    outcome = keymint("authority", "show", cwd=ws)
    assert outcome.code == 0
    for said in ("CN=identity_ca", "digitalSignature, keyCertSign, cRLSign", "renew after 2036-01-12", "here"):
        assert said in outcome.out
    assert "2 packages (permissions, signs; keymint_ros2_dds)" in outcome.out
    (ws / AUTHORITY_KEYS[0]).unlink()
    document = keymint("authority", "show", IDENTITY, "--json", cwd=ws).document
    [shown] = document["result"]["authorities"]
    assert (shown["name"], shown["private_key"], shown["replacement"]) == (IDENTITY, "elsewhere", None)
    assert shown["certificate"]["fingerprint"] == keys.fingerprint(certificate(ws / CERTIFICATES[0]).public_key())
    assert shown["serves"] == [{"build_type": "keymint_ros2_dds", "role": "identity", "signs": False, "packages": 2}]


def test_show_of_an_unknown_authority(keymint, ws: Path) -> None:
    outcome = keymint("authority", "show", "identity-ca", cwd=ws)
    assert (outcome.code, "did you mean 'identity_ca'?" in outcome.err) == (2, True)


def test_show_without_a_certificate(keymint, ws: Path) -> None:
    (ws / CERTIFICATES[0]).unlink()
    outcome = keymint("authority", "show", cwd=ws)
    assert (outcome.code, "no certificate" in outcome.out) == (0, True)


# -- renew -----------------------------------------------------------------------------------------------------------


def test_renewing_keeps_key_name_and_the_certificates_of_subjects(keymint, ws: Path) -> None:
    old, leaves = certificate(ws / CERTIFICATES[0]), [ws / f"install/enclaves/{name}/cert.pem" for name in ENCLAVES]
    before, keys_before = [leaf.read_bytes() for leaf in leaves], trusted(ws)
    outcome = keymint("authority", "renew", IDENTITY, cwd=ws, env=LATER)
    assert outcome.code == 0, outcome.err
    assert "robots that have it and others work together" in outcome.err
    new = certificate(ws / CERTIFICATES[0])
    assert new.public_key() == old.public_key()
    assert new.subject == old.subject
    assert new.serial_number != old.serial_number
    assert new.not_valid_before_utc == old.not_valid_before_utc
    assert (new.not_valid_after_utc - old.not_valid_after_utc).days == YEAR // 2 // 86400
    assert [leaf.read_bytes() for leaf in leaves] == before
    assert trusted(ws) == keys_before
    openssl_accepts(ws)
    assert keymint("check", cwd=ws, env=LATER).code == 0
    assert keymint("authority", "renew", IDENTITY, cwd=ws, env=LATER).out.startswith("nothing to do")
    assert keymint("install", cwd=ws, env=LATER).out.startswith("nothing to do")


@pytest.mark.parametrize("shorter", [True, False])
def test_a_revocation_list_that_ends_with_its_authority_is_issued_again(keymint, ws: Path, shorter: bool) -> None:
    assert keymint("revoke", "talker", "--reason", "superseded", cwd=ws).code == 0
    if shorter:
        assert keymint("crl", "--refresh", "--valid-for", "400d", cwd=ws).code == 0
    before = (ws / "public/identity_ca.crl.pem").read_bytes()
    outcome = keymint("authority", "renew", IDENTITY, cwd=ws, env=LATER)
    assert outcome.code == 0, outcome.err
    found = x509.load_pem_x509_crl((ws / "public/identity_ca.crl.pem").read_bytes())
    assert ((ws / "public/identity_ca.crl.pem").read_bytes() == before) is shorter
    if not shorter:
        assert found.next_update_utc == certificate(ws / CERTIFICATES[0]).not_valid_after_utc
        assert (ws / "install/enclaves/robot1/listener/crl.pem").read_bytes() != before
    assert keymint("check", cwd=ws, env=LATER).code == 0


def test_a_dry_run_of_a_renewal_writes_nothing(keymint, ws: Path) -> None:
    before = snapshot(ws)
    outcome = keymint("authority", "renew", IDENTITY, "--dry-run", cwd=ws, env=LATER)
    assert (outcome.code, "would be" in outcome.out) == (0, True)
    assert snapshot(ws) == before


def test_renewing_the_signer_of_documents_is_a_flag_day(keymint, ws: Path) -> None:
    before = content(ws)
    refused = keymint("authority", "renew", PERMISSIONS, "--json", cwd=ws, env=LATER)
    assert (refused.code, refused.codes()) == (1, ["authority-flag-day"])
    assert "Cyclone DDS 0.10 and Fast DDS 2.9" in refused.document["diagnostics"][0]["message"]
    assert content(ws) == before
    outcome = keymint("authority", "renew", PERMISSIONS, "--flag-day", cwd=ws, env=LATER)
    assert outcome.code == 0, outcome.err
    assert "all robots restart together" in outcome.err
    openssl_accepts(ws)
    assert keymint("check", cwd=ws, env=LATER).code == 0


def test_before_anything_is_installed_nobody_restarts(keymint, policy: Path, tmp_path: Path) -> None:
    assert keymint("init", "ws", "--policy", policy).code == 0
    outcome = keymint("authority", "renew", PERMISSIONS, "-w", "ws", env=LATER)
    assert (outcome.code, outcome.err) == (0, "")
    assert certificate(tmp_path / "ws" / CERTIFICATES[1]).not_valid_after_utc.year == 2037


def test_renewing_needs_the_key(keymint, ws: Path) -> None:
    (ws / AUTHORITY_KEYS[0]).unlink()
    before = content(ws)
    outcome = keymint("authority", "renew", IDENTITY, cwd=ws, env=LATER)
    assert outcome.code == 1
    assert "'keymint authority export identity_ca' there" in outcome.err
    assert content(ws) == before


def test_a_certificate_that_was_renewed_elsewhere_is_imported(keymint, ws: Path, tmp_path: Path) -> None:
    """The key lies on another machine; what it signs travels as a file."""
    (ws / "private/identity_ca.key.pem").rename(tmp_path / "offline.pem")
    elsewhere = tmp_path / "elsewhere"
    assert keymint("init", elsewhere).code == 0
    (elsewhere / AUTHORITY_KEYS[0]).write_bytes((tmp_path / "offline.pem").read_bytes())
    (elsewhere / CERTIFICATES[0]).write_bytes((ws / CERTIFICATES[0]).read_bytes())
    assert keymint("authority", "renew", IDENTITY, cwd=elsewhere, env=LATER).code == 0
    assert keymint("authority", "export", IDENTITY, "-o", tmp_path / "new.pem", cwd=elsewhere).code == 0
    outcome = keymint("authority", "import", IDENTITY, tmp_path / "new.pem", cwd=ws, env=LATER)
    assert outcome.code == 0, outcome.err
    assert certificate(ws / CERTIFICATES[0]) == certificate(tmp_path / "new.pem")
    openssl_accepts(ws)
    for verb in ("check", "prove", "build", "install", "status"):
        assert keymint(verb, cwd=ws, env=LATER).code == 0, verb


def test_without_any_key_everything_works_that_needs_no_signature(keymint, ws: Path, tmp_path: Path) -> None:
    elsewhere = tmp_path / "elsewhere"
    shutil.copytree(ws, elsewhere)
    for path in AUTHORITY_KEYS:
        (ws / path).unlink()
    assert keymint("authority", "renew", IDENTITY, cwd=elsewhere, env=LATER).code == 0
    assert keymint("authority", "export", IDENTITY, "-o", "../new.pem", cwd=elsewhere).code == 0
    outcome = keymint("authority", "import", IDENTITY, "../new.pem", cwd=ws, env=LATER)
    assert outcome.code == 0, outcome.err
    openssl_accepts(ws)
    for verb in ("check", "prove", "build", "install", "status", "authority show"):
        outcome = keymint(*verb.split(), cwd=ws, env=LATER)
        assert outcome.code == 0, (verb, outcome.err)
    (ws / "install/enclaves/talker/permissions.p7s").unlink()
    before = content(ws)
    waiting = keymint("install", "--json", cwd=ws, env=LATER)
    assert (waiting.code, waiting.codes()[0]) == (1, "authority-key-missing")
    assert "permissions_ca" in waiting.document["diagnostics"][0]["message"]
    assert keymint("install", "robot1/listener", cwd=ws, env=LATER).code == 0
    assert content(ws) == before


# -- import ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("with_key", [True, False])
def test_an_authority_from_outside(keymint, policy: Path, tmp_path: Path, with_key: bool) -> None:
    pem, key = outside()
    (tmp_path / "ca.pem").write_bytes(pem)
    (tmp_path / "ca.key").write_bytes(key)
    assert keymint("init", "ws", "--policy", policy).code == 0
    words = ("--key", "ca.key") if with_key else ()
    outcome = keymint("authority", "import", IDENTITY, "ca.pem", *words, "-w", "ws")
    assert outcome.code == 0, outcome.err
    ws = tmp_path / "ws"
    assert (ws / CERTIFICATES[0]).read_bytes() == pem
    assert (ws / AUTHORITY_KEYS[0]).exists() is with_key
    assert keymint("create", "--all", cwd=ws).code == 0
    assert keymint("build", cwd=ws).code == 0
    installed = keymint("install", "--json", cwd=ws)
    if not with_key:
        assert installed.codes().count("authority-key-missing") >= 1
        return
    assert installed.code == 0
    assert stat.S_IMODE((ws / AUTHORITY_KEYS[0]).stat().st_mode) == 0o600
    openssl_accepts(ws)
    assert keymint("check", cwd=ws).code == 0
    assert "(imported)" in keymint("authority", "show", cwd=ws).out
    (ws / AUTHORITY_KEYS[0]).rename(ws / "away")
    (ws / CERTIFICATES[0]).write_bytes(outside()[0])
    (ws / ".keymint/state.json").unlink()
    assert "authority-drift" in keymint("prove", "--json", cwd=ws).codes()
    (ws / "away").rename(ws / AUTHORITY_KEYS[0])
    (ws / CERTIFICATES[0]).unlink()
    assert keymint("install", cwd=ws).code == 0
    assert (ws / CERTIFICATES[0]).read_bytes() == pem
    assert "'keymint authority replace identity_ca'" in keymint("install", "--new-authority", IDENTITY, cwd=ws).err


def test_what_an_imported_certificate_lacks_is_told_and_mended(keymint, policy: Path, tmp_path: Path) -> None:
    pem, key = outside(lists=False, identifier=False)
    (tmp_path / "ca.pem").write_bytes(pem)
    (tmp_path / "ca.key").write_bytes(key)
    assert keymint("init", "ws", "--policy", policy).code == 0
    ws = tmp_path / "ws"
    outcome = keymint("authority", "import", IDENTITY, "../ca.pem", "--key", "../ca.key", cwd=ws)
    assert outcome.code == 0, outcome.err
    assert keymint("provision", policy, "-w", "ws").code == 0
    codes = keymint("authority", "show", "--json", cwd=ws).codes()
    assert codes == ["authority-cannot-revoke", "authority-without-identifier"]
    assert keymint("authority", "renew", IDENTITY, cwd=ws).code == 0
    assert keymint("authority", "show", "--json", cwd=ws).codes() == []
    new = certificate(ws / CERTIFICATES[0])
    assert new.subject == x509.load_pem_x509_certificate(pem).subject
    assert new.extensions.get_extension_for_class(x509.KeyUsage).value.crl_sign
    openssl_accepts(ws)
    assert keymint("check", cwd=ws).code == 0


@pytest.mark.parametrize(
    ("pem", "code"),
    [
        (outside(ca=False)[0], "authority-unsuitable"),
        (b"no certificate", "certificate-invalid"),
        (outside()[0] * 2, "certificate-invalid"),
    ],
    ids=["no authority", "garbage", "two"],
)
def test_what_is_no_authority_is_not_imported(keymint, ws: Path, pem: bytes, code: str) -> None:
    (ws.parent / "ca.pem").write_bytes(pem)
    before = content(ws)
    outcome = keymint("authority", "import", IDENTITY, "../ca.pem", "--json", cwd=ws)
    assert (outcome.code, outcome.codes()) == (1, [code])
    assert content(ws) == before


def test_another_key_than_the_deployed_one_is_not_imported(keymint, ws: Path) -> None:
    (ws.parent / "ca.pem").write_bytes(outside(IDENTITY)[0])
    before = content(ws)
    outcome = keymint("authority", "import", IDENTITY, "../ca.pem", cwd=ws)
    assert outcome.code == 1
    assert "'keymint authority replace identity_ca --certificate ../ca.pem'" in outcome.err
    assert content(ws) == before


def test_a_key_of_another_certificate_is_not_imported(keymint, policy: Path, tmp_path: Path) -> None:
    (tmp_path / "ca.pem").write_bytes(outside()[0])
    (tmp_path / "ca.key").write_bytes(outside()[1])
    assert keymint("init", "ws", "--policy", policy).code == 0
    outcome = keymint("authority", "import", IDENTITY, "ca.pem", "--key", "ca.key", "-w", "ws", "--json")
    assert (outcome.code, outcome.codes()) == (1, ["authority-key-mismatch"])


# -- export ----------------------------------------------------------------------------------------------------------


def test_export(keymint, ws: Path, tmp_path: Path) -> None:
    assert keymint("authority", "export", IDENTITY, cwd=ws).out == (ws / CERTIFICATES[0]).read_text()
    assert keymint("authority", "export", IDENTITY, "-o", "ca.pem", "-w", "ws").code == 0
    assert (tmp_path / "ca.pem").read_bytes() == (ws / CERTIFICATES[0]).read_bytes()
    assert keymint("authority", "export", IDENTITY, "--chain", cwd=ws).out == (ws / CERTIFICATES[0]).read_text()
    document = keymint("authority", "export", IDENTITY, "--json", cwd=ws)
    assert "PRIVATE" not in document.out
    assert document.document["result"]["certificate"] == (ws / CERTIFICATES[0]).read_text()


def test_the_key_is_exported_only_if_that_is_asked_for(keymint, ws: Path, tmp_path: Path) -> None:
    outcome = keymint("authority", "export", IDENTITY, "-o", "ca.pem", "--with-key", "ca.key", "-w", "ws", "--json")
    assert (outcome.code, outcome.codes()) == (0, ["key-exported"])
    assert "PRIVATE KEY" not in outcome.out + outcome.err
    exported = tmp_path / "ca.key"
    assert stat.S_IMODE(exported.stat().st_mode) == 0o600
    assert exported.read_bytes() == (ws / AUTHORITY_KEYS[0]).read_bytes()
    same = keymint("authority", "export", IDENTITY, "-o", "x", "--with-key", "x", "-w", "ws")
    assert (same.code, (tmp_path / "x").exists()) == (2, False)
    (ws / AUTHORITY_KEYS[0]).unlink()
    assert keymint("authority", "export", IDENTITY, "--with-key", "y", "-w", "ws").code == 1
