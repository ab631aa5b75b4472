# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import base64
from datetime import UTC, datetime, timedelta

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization

from comarmor.errors import Origin
from keymint.api import CertificateSpec, KeySpec
from keymint.pki import certificates, keys
from keymint.pki.examine import verify_chain

NOW = datetime(2026, 11, 21, tzinfo=UTC)
HERE = Origin("install/enclaves/talker/cert.pem")
P256 = KeySpec("ec", "SECP256R1")


def _codes(certificate: bytes, *bundle: certificates.Issuer, at: datetime = NOW) -> list[str]:
    pem = b"".join(certificates.to_pem(each.certificate) for each in bundle)
    findings = verify_chain(certificate, pem, at, HERE)
    assert all(finding.where == HERE and finding.help and "\n" not in finding.message for finding in findings)
    return [finding.code for finding in findings]


def _authority(spec: CertificateSpec, issuer: certificates.Issuer | None = None) -> certificates.Issuer:
    key = keys.generate(spec.key)
    return certificates.Issuer(
        certificates.issue(spec, key.public_key(), issuer or key, authority=True).certificate, key
    )


def _identity(spec: CertificateSpec, issuer: certificates.Issuer) -> bytes:
    return certificates.issue(spec, keys.generate(P256).public_key(), issuer, authority=False).pem


def _forge(issuer: certificates.Issuer, *extensions: x509.ExtensionType, subject: str = "/a") -> certificates.Issuer:
    """Return a certificate that issuing would refuse."""
    key = keys.generate(P256)
    name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, subject)])
    builder = (
        x509.CertificateBuilder()
        .issuer_name(issuer.certificate.subject)
        .subject_name(name)
        .public_key(key.public_key())
        .serial_number(7)
        .not_valid_before(datetime(2020, 1, 1, tzinfo=UTC))
        .not_valid_after(datetime(2040, 1, 1, tzinfo=UTC))
    )
    for extension in extensions:
        builder = builder.add_extension(extension, critical=True)
    return certificates.Issuer(builder.sign(issuer.key, hashes.SHA256()), key)


def test_an_identity_and_its_authority_are_clean(spec, authority: certificates.Issuer) -> None:
    assert _codes(_identity(spec("CN=/a"), authority), authority) == []
    assert _codes(certificates.to_pem(authority.certificate), authority) == []


def test_a_hierarchy_is_clean_in_any_order(spec) -> None:
    root = _authority(spec("CN=root", basicConstraints="critical, CA:TRUE, pathlen:1"))
    middle = _authority(spec("CN=middle"), root)
    pem = _identity(spec("CN=/a"), middle)
    assert _codes(pem, root, middle) == []
    assert _codes(pem, middle, root) == []
    assert _codes(pem, middle) == ["chain-incomplete"]
    assert _codes(pem, root) == ["chain-incomplete"]


def test_a_path_longer_than_its_root_allows(openssl, spec) -> None:
    root = _authority(spec("CN=root", basicConstraints="critical, CA:TRUE, pathlen:1"))
    middle = _authority(spec("CN=middle"), root)
    lower = _authority(spec("CN=lower"), middle)
    pem = _identity(spec("CN=/a"), lower)
    assert _codes(pem, lower, middle, root) == ["chain-path-length"]
    pems = {name: certificates.to_pem(each.certificate) for name, each in (("root", root), ("m", middle), ("l", lower))}
    openssl.put(root=pems["root"], between=pems["m"] + pems["l"], identity=pem)
    openssl.refuses("verify", "-CAfile", "root", "-untrusted", "between", "identity")


def test_another_authority_of_the_same_name(spec, authority: certificates.Issuer, other: certificates.Issuer) -> None:
    pem = _identity(spec("CN=/a"), authority)
    assert _codes(pem, other) == ["chain-signature"]
    assert _codes(pem, other, authority) == []


def test_self_signed_certificates_are_trusted_only_as_authorities(
    spec, authority: certificates.Issuer, other: certificates.Issuer
) -> None:
    alone = certificates.to_pem(_authority(spec("CN=alone")).certificate)
    assert _codes(alone, authority) == ["chain-incomplete"]
    assert _codes(certificates.to_pem(other.certificate), authority) == ["chain-signature"]


def test_validity_at_each_link(spec, authority: certificates.Issuer) -> None:
    pem = _identity(spec("CN=/a"), authority)
    assert _codes(pem, authority, at=datetime(2041, 1, 1, tzinfo=UTC)) == ["certificate-expired"] * 2
    assert _codes(pem, authority, at=datetime(2019, 1, 1, tzinfo=UTC)) == ["certificate-not-yet-valid"] * 2
    assert _codes(pem, authority, at=datetime(2040, 1, 1, tzinfo=UTC)) == []


def test_issuers_that_are_no_authorities(spec, authority: certificates.Issuer) -> None:
    identity = _forge(authority, x509.BasicConstraints(ca=False, path_length=None), subject="leaf")
    evil = _forge(identity, subject="evil")
    assert _codes(certificates.to_pem(evil.certificate), identity, authority) == ["chain-not-authority"]
    without = _forge(authority, subject="without")
    evil = _forge(without, subject="evil")
    assert _codes(certificates.to_pem(evil.certificate), without, authority) == ["chain-not-authority"]


def test_issuers_that_may_not_sign_certificates(authority: certificates.Issuer) -> None:
    usage = x509.KeyUsage(True, False, False, False, False, False, False, False, False)
    middle = _forge(authority, x509.BasicConstraints(ca=True, path_length=None), usage, subject="middle")
    leaf = _forge(middle)
    assert _codes(certificates.to_pem(leaf.certificate), middle, authority) == ["chain-key-usage"]


def test_unknown_critical_extensions(authority: certificates.Issuer) -> None:
    odd = _forge(authority, x509.UnrecognizedExtension(x509.ObjectIdentifier("1.2.3.4"), b"\x05\x00"))
    assert _codes(certificates.to_pem(odd.certificate), authority) == ["chain-critical-extension"]


def test_every_changed_byte_is_found(spec, authority: certificates.Issuer) -> None:
    """Of the certificate itself: in a file, base64 has more than one text for it (``is_canonical`` is for that)."""
    pem = _identity(spec("C=US,CN=/a,emailAddress=a@b.c", subjectAltName="DNS:a.b"), authority)
    content = certificates.load(pem).public_bytes(serialization.Encoding.DER)
    assert _codes(_as_pem(content), authority) == []
    for position in range(len(content)):
        for mask in (0x01, 0x80):
            damaged = bytearray(content)
            damaged[position] ^= mask
            assert _codes(_as_pem(bytes(damaged)), authority), (position, mask)


def test_unused_bits_of_a_signature_are_no_hiding_place(spec, authority: certificates.Issuer) -> None:
    """No signature covers them, and the library passes over them (X.690, 8.6.2.2)."""
    public = keys.generate(P256).public_key()
    while (certificate := certificates.issue(spec(), public, authority, authority=False).certificate).signature[-1] & 1:
        pass
    content = bytearray(certificate.public_bytes(serialization.Encoding.DER))
    content[len(content) - len(certificate.signature) - 1] = 1
    assert _codes(_as_pem(bytes(content)), authority) == ["certificate-invalid"]


def _as_pem(content: bytes) -> bytes:
    return b"-----BEGIN CERTIFICATE-----\n" + base64.encodebytes(content) + b"-----END CERTIFICATE-----\n"


@pytest.mark.parametrize("pem", [b"", b"junk"])
def test_what_is_no_certificate_is_a_finding(authority: certificates.Issuer, pem: bytes) -> None:
    assert _codes(pem, authority) == ["certificate-invalid"]
    assert [each.code for each in verify_chain(certificates.to_pem(authority.certificate), pem, NOW)] == [
        "certificate-invalid"
    ]


@pytest.mark.parametrize("pem", [b"", b"junk"])
def test_without_authorities_the_certificate_is_checked_alone(authority: certificates.Issuer, pem: bytes) -> None:
    late = authority.certificate.not_valid_after_utc + timedelta(days=1)
    assert [each.code for each in verify_chain(certificates.to_pem(authority.certificate), pem, late)] == [
        "certificate-invalid",
        "certificate-expired",
    ]


def test_authorities_that_issue_each_other_are_no_path(spec) -> None:
    first_key, second_key = keys.generate(P256), keys.generate(P256)
    first = certificates.Issuer(
        certificates.issue(spec("CN=one"), first_key.public_key(), first_key, authority=True).certificate, first_key
    )
    second = certificates.Issuer(
        certificates.issue(spec("CN=two"), second_key.public_key(), first, authority=True).certificate, second_key
    )
    loop = certificates.Issuer(
        certificates.issue(spec("CN=one"), first_key.public_key(), second, authority=True).certificate, first_key
    )
    assert _codes(certificates.to_pem(loop.certificate), loop, second) == ["chain-incomplete"]
