# SPDX-License-Identifier: Apache-2.0
"""Installed certificates: each is in the register, as it was issued, and has the dates of its sources."""

from __future__ import annotations

from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding

from .fault_keystores import DAY, TALKER, put
from .presented import codes, findings, keystore

VERBS = ("check", "prove")
CERTIFICATE = "install/enclaves/talker/cert.pem"


def of_certificate(keymint, ws: Path, verb: str, code: str) -> dict[str, str]:
    """Return the one finding of a code, which is about talker's certificate."""
    (found,) = (each for each in findings(keymint, ws, verb) if each["code"] == code)
    assert (found["file"], found["subject"]) == (CERTIFICATE, "/talker")
    return found


@pytest.mark.parametrize("verb", VERBS)
@pytest.mark.parametrize("end", [200, 8 * 365], ids=["200 days", "8 years"])
def test_a_certificate_that_nobody_registered(keymint, provisioned: Path, verb: str, end: int) -> None:
    put(provisioned / CERTIFICATE, keystore(provisioned).issue(TALKER, end=end * DAY))
    found = of_certificate(keymint, provisioned, verb, "certificate-unregistered")
    assert "that nobody registered" in found["message"]
    assert "the key of 'identity_ca'" in found["help"]


@pytest.mark.parametrize("verb", VERBS)
def test_a_foreign_authority_of_the_same_name_does_not_accuse_ours(keymint, provisioned: Path, verb: str) -> None:
    ours = x509.load_pem_x509_certificate((provisioned / CERTIFICATE).read_bytes())
    forged = x509.CertificateBuilder(
        ours.issuer, ours.subject, ours.public_key(), 12345, ours.not_valid_before_utc, ours.not_valid_after_utc
    ).sign(ec.generate_private_key(ec.SECP256R1()), hashes.SHA256())
    put(provisioned / CERTIFICATE, forged.public_bytes(Encoding.PEM))
    found = codes(keymint, provisioned, verb)
    assert "chain-signature" in found
    assert "certificate-unregistered" not in found


@pytest.mark.parametrize("verb", VERBS)
def test_installing_again_ends_it(keymint, provisioned: Path, verb: str) -> None:
    put(provisioned / CERTIFICATE, keystore(provisioned).issue(TALKER))
    assert keymint("install", "talker", cwd=provisioned).code == 0
    assert codes(keymint, provisioned, verb) == set()


@pytest.mark.parametrize("verb", VERBS)
def test_dates_that_the_sources_do_not_ask_for(keymint, provisioned: Path, verb: str) -> None:
    """The register knows the certificate, but the package asks for other dates since."""
    sources = provisioned / "src/talker/issuance.xml"
    before = (provisioned / CERTIFICATE).read_bytes()
    later = {"SOURCE_DATE_EPOCH": str(1_800_000_000 + 30 * 86_400)}
    assert keymint("renew", "talker", cwd=provisioned, env=later).code == 0
    assert sources.exists()
    put(provisioned / CERTIFICATE, before)
    found = of_certificate(keymint, provisioned, verb, "certificate-drift")
    assert "which is not what the sources ask for" in found["message"]


@pytest.mark.parametrize("verb", VERBS)
def test_a_revoked_enclave_that_somebody_copied_back(keymint, provisioned: Path, verb: str) -> None:
    enclave = provisioned / "install/enclaves/talker"
    before = {path.name: path.read_bytes() for path in enclave.iterdir()}
    assert keymint("revoke", "talker", "--reason", "key-compromise", cwd=provisioned).code == 0
    enclave.mkdir()
    for name, content in before.items():
        (enclave / name).write_bytes(content)
        (enclave / name).chmod(0o600 if name == "key.pem" else 0o644)
    found = of_certificate(keymint, provisioned, verb, "certificate-revoked")
    assert found["message"] == "was revoked on 2027-01-15T08:00:00Z (key-compromise)"
    put(enclave / "crl.pem", (provisioned / "install/enclaves/robot1/listener/crl.pem").read_bytes())
    for each in findings(keymint, provisioned, verb):
        assert "remove it" not in each["help"]


@pytest.mark.parametrize("verb", VERBS)
def test_without_a_register_nobody_knows(keymint, provisioned: Path, verb: str) -> None:
    put(provisioned / CERTIFICATE, keystore(provisioned).issue(TALKER))
    (provisioned / "private/register.sqlite3").unlink()
    assert "certificate-unregistered" not in codes(keymint, provisioned, verb)
