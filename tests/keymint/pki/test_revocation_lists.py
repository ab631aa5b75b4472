# SPDX-License-Identifier: Apache-2.0
"""Revocation lists: openssl enforces them, and only what every vendor accepts is issued."""

from __future__ import annotations

import base64
from datetime import UTC, datetime, timedelta

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey
from cryptography.hazmat.primitives.serialization import Encoding

from comarmor.errors import Origin
from keymint.errors import KeymintError
from keymint.life.register import REASONS
from keymint.pki import certificates, keys, revocation_lists
from keymint.pki.certificates import Issuer
from keymint.pki.revocation_lists import Revocation
from keymint.robots import bundle

NOW = datetime(2027, 1, 15, 8, tzinfo=UTC)
WHERE = Origin("public/ca.crl.pem")


@pytest.fixture
def ca(spec) -> Issuer:
    return authority(spec("CN=ca"))


def authority(of) -> Issuer:
    key = keys.generate(of.key)
    return Issuer(certificates.issue(of, key.public_key(), key, authority=True).certificate, key)


def test_openssl_refuses_the_revoked_certificate_only(openssl, spec, ca: Issuer) -> None:
    robots = [
        certificates.issue(
            spec(f"CN=/robot{number}"), keys.generate(spec("CN=x").key).public_key(), ca, authority=False
        )
        for number in range(2)
    ]
    stolen = Revocation(robots[0].certificate.serial_number, NOW, "key-compromise")
    openssl.put(
        ca=certificates.to_pem(ca.certificate), stolen=robots[0].pem, other=robots[1].pem,
        crl=revocation_lists.issue(ca, [stolen], 1, NOW), empty=revocation_lists.issue(ca, [], 2, NOW),
    )  # fmt: skip
    at = ("-attime", str(int(NOW.timestamp())))
    checked = ("verify", "-x509_strict", "-crl_check", *at, "-CAfile", "ca", "-CRLfile")
    openssl.accepts(*checked, "crl", "other")
    openssl.refuses(*checked, "crl", "stolen")
    openssl.accepts(*checked, "empty", "stolen")
    text = openssl.run("crl", "-in", "crl", "-noout", "-text").stdout.decode()
    assert "Key Compromise" in text
    assert "X509v3 CRL Number" in text
    assert "X509v3 Authority Key Identifier" in text


def test_round_trip(ca: Issuer) -> None:
    assert len(REASONS) == 6
    revoked = [Revocation(serial, NOW, reason) for serial, reason in enumerate(REASONS, 1)]
    pem = revocation_lists.issue(ca, reversed(revoked), 41, NOW)
    read = revocation_lists.load(pem, WHERE)
    assert (read.number, list(read.revocations)) == (41, revoked)
    assert read.this_update == NOW - timedelta(days=1)
    assert read.next_update == ca.certificate.not_valid_after_utc
    assert revocation_lists.problem(pem, ca.certificate) == ""


def test_it_neither_begins_before_its_authority_nor_outlives_it(ca: Issuer) -> None:
    begin, end = ca.certificate.not_valid_before_utc, ca.certificate.not_valid_after_utc
    read = revocation_lists.load(revocation_lists.issue(ca, [], 1, begin, end + timedelta(9)), WHERE)
    assert (read.this_update, read.next_update) == (begin, end)
    short = revocation_lists.load(revocation_lists.issue(ca, [], 1, NOW, NOW + timedelta(30)), WHERE)
    assert short.next_update == NOW + timedelta(30)


def test_lists_of_others(ca: Issuer, spec) -> None:
    pem = revocation_lists.issue(ca, [], 1, NOW)
    same_name, other_name = authority(spec("CN=ca")), authority(spec("CN=other"))
    for other in (same_name, other_name):
        assert "not a revocation list of the certificate's issuer" in revocation_lists.problem(pem, other.certificate)
    assert "not a revocation list in PEM" in revocation_lists.problem(b"", ca.certificate)
    crl = revocation_lists.first(pem)
    assert crl is not None
    found = [revocation_lists.is_by(crl, each.certificate) for each in (ca, same_name, other_name)]
    assert found == [True, False, False]
    assert revocation_lists.period(crl) == (NOW - timedelta(days=1), ca.certificate.not_valid_after_utc)


def test_an_authority_whose_key_nothing_can_verify_with_issued_no_list(ca: Issuer) -> None:
    crl = revocation_lists.first(revocation_lists.issue(ca, [], 1, NOW))
    builder = x509.CertificateBuilder(
        ca.certificate.subject, ca.certificate.subject, X25519PrivateKey.generate().public_key()
    )
    builder = builder.serial_number(1).not_valid_before(NOW).not_valid_after(NOW + timedelta(days=1))
    assert crl is not None
    assert not revocation_lists.is_by(crl, builder.sign(ca.key, hashes.SHA256()))


def of_another_version(pem: bytes) -> bytes:
    der = x509.load_pem_x509_crl(pem).public_bytes(Encoding.DER)
    changed = base64.encodebytes(der.replace(b"\x02\x01\x01", b"\x02\x01\x35", 1))
    return b"-----BEGIN X509 CRL-----\n" + changed + b"-----END X509 CRL-----\n"


@pytest.mark.parametrize(
    "change",
    [lambda _pem: b"", lambda pem: pem + pem, lambda pem: pem[:-40], lambda pem: b"x\n" + pem, of_another_version],
)
def test_a_file_has_exactly_one_list(ca: Issuer, change) -> None:
    with pytest.raises(KeymintError, match="is not one revocation list in PEM"):
        revocation_lists.load(change(revocation_lists.issue(ca, [], 1, NOW)), WHERE)


def test_a_list_of_another_version_cannot_be_read(ca: Issuer) -> None:
    pem = of_another_version(revocation_lists.issue(ca, [], 1, NOW))
    assert revocation_lists.first(pem) is None
    assert "not a revocation list in PEM" in revocation_lists.problem(pem, ca.certificate)
    with pytest.raises(ValueError, match="version"):
        bundle.revocation_lists({"crl.pem": pem})


def test_an_authority_that_cannot_sign_lists(spec) -> None:
    adopted = authority(spec("CN=ca", keyUsage="critical, keyCertSign, digitalSignature"))
    with pytest.raises(KeymintError, match="its keyUsage lacks cRLSign") as caught:
        revocation_lists.require_signs_lists(adopted.certificate, WHERE)
    assert caught.value.diagnostics[0].where == WHERE
