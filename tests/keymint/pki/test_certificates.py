# SPDX-License-Identifier: Apache-2.0
"""Certificates: issued as openssl accepts them, read back, and compared with their specification."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime, timedelta

import pytest

from comarmor.errors import Origin
from keymint.api import CertificateSpec, KeySpec, Validity
from keymint.errors import KeymintError
from keymint.pki import certificates, keys

KEYS = [KeySpec("ec", "SECP256R1"), KeySpec("ec", "SECP384R1"), KeySpec("rsa", size=2048)]
P256 = KEYS[0]


def _authority(spec: CertificateSpec, issuer: certificates.Issuer | None = None) -> certificates.Issuer:
    key = keys.generate(spec.key)
    return certificates.Issuer(
        certificates.issue(spec, key.public_key(), issuer or key, authority=True).certificate, key
    )


@pytest.mark.parametrize("kind", KEYS, ids=lambda spec: spec.curve or f"rsa{spec.size}")
@pytest.mark.parametrize("hash_algorithm", ["SHA256", "SHA384", "SHA512"])
def test_openssl_accepts_authorities_and_identities(openssl, spec, kind: KeySpec, hash_algorithm: str) -> None:
    ca = _authority(spec("C=US, O=Acme, CN=ca/emailAddress=a@b.c", key=kind, hash_algorithm=hash_algorithm))
    identity = certificates.issue(
        spec("CN=/robot,OU=x1", hash_algorithm=hash_algorithm), keys.generate(P256).public_key(), ca, authority=False
    )
    openssl.put(ca=certificates.to_pem(ca.certificate), identity=identity.pem)
    openssl.accepts("verify", "-x509_strict", "-CAfile", "ca", "ca", "identity")
    for purpose in ("sslserver", "sslclient"):
        openssl.accepts("verify", "-x509_strict", "-purpose", purpose, "-CAfile", "ca", "identity")
    openssl.refuses("verify", "-purpose", "smimesign", "-CAfile", "ca", "identity")
    openssl.accepts("verify", "-purpose", "smimesign", "-CAfile", "ca", "ca")
    text = openssl.run("x509", "-in", "identity", "-noout", "-text", "-nameopt", "oneline,-space_eq").stdout.decode()
    assert "Subject: CN=/robot, OU=x1" in text
    assert "CA:FALSE" in text
    assert certificates.is_canonical(identity.pem)


def test_openssl_accepts_a_hierarchy(openssl, spec) -> None:
    root = _authority(spec("CN=root", basicConstraints="critical, CA:TRUE, pathlen:1"))
    middle = _authority(spec("CN=middle", basicConstraints="critical, CA:TRUE, pathlen:0"), root)
    identity = certificates.issue(spec("CN=/robot"), keys.generate(P256).public_key(), middle, authority=False)
    openssl.put(
        root=certificates.to_pem(root.certificate),
        middle=certificates.to_pem(middle.certificate),
        identity=identity.pem,
    )
    openssl.accepts("verify", "-x509_strict", "-CAfile", "root", "-untrusted", "middle", "identity")
    with pytest.raises(KeymintError, match="pathlen:0") as caught:
        _authority(spec("CN=bottom"), middle)
    assert caught.value.diagnostics[0].where == Origin("profile/authorities.xml", 7)


@pytest.mark.parametrize("role", ["root", "middle", "identity"])
def test_an_unchanged_certificate_is_kept_and_any_change_is_seen(
    spec, authority: certificates.Issuer, other: certificates.Issuer, role: str
) -> None:
    key = keys.generate(P256)
    wanted = spec("CN=/robot,OU=x1", subjectAltName="DNS:a", nsComment="hello", validity=_years(2021, 2060))
    if role == "identity":
        issued, issuer = certificates.issue(wanted, key.public_key(), authority, authority=False), authority.certificate
    else:
        issued = certificates.issue(wanted, key.public_key(), authority if role == "middle" else key, authority=True)
        issuer = authority.certificate if role == "middle" else None

    def kept(
        spec: CertificateSpec = wanted, pem: bytes = issued.pem, by=issuer, public: keys.PublicKey | None = None
    ) -> bool:
        return certificates.certificate_satisfies(
            pem, spec, public or key.public_key(), by, authority=role != "identity"
        )

    assert kept()
    assert kept(replace(wanted, serial=issued.certificate.serial_number))
    changes = [
        replace(wanted, subject_name="CN=/robot,OU=x2"),
        replace(wanted, serial=1),
        replace(wanted, hash_algorithm="SHA384"),
        replace(wanted, validity=_years(2022, 2060)),
        replace(wanted, validity=_years(2021, 2030)),
        replace(wanted, extensions=wanted.extensions[:1]),
        replace(wanted, extensions=(replace(wanted.extensions[0], critical=True), wanted.extensions[1])),
        replace(wanted, extensions=(replace(wanted.extensions[0], value="DNS:b"), wanted.extensions[1])),
    ]
    assert not [change for change in changes if kept(change)]
    assert not kept(public=keys.generate(P256).public_key())
    assert not kept(by=other.certificate)
    assert not kept(pem=issued.pem + b"\n")
    assert not kept(pem=b"junk")
    assert not kept(pem=certificates.to_pem(authority.certificate))
    if role != "root":
        assert kept(replace(wanted, validity=_years(2021, 2050)))  # both are cut to the issuer's end


def _years(first: int, last: int) -> Validity:
    return Validity(datetime(first, 1, 1, tzinfo=UTC), datetime(last, 1, 1, tzinfo=UTC))


def test_every_changed_byte_of_a_certificate_is_found(spec, authority: certificates.Issuer) -> None:
    wanted, key = spec("CN=/robot"), keys.generate(P256).public_key()
    pem = certificates.issue(wanted, key, authority, authority=False).pem
    for position in range(len(pem)):
        damaged = bytearray(pem)
        damaged[position] ^= 1
        assert not certificates.certificate_satisfies(
            bytes(damaged), wanted, key, authority.certificate, authority=False
        ), position


@pytest.mark.parametrize(
    ("extensions", "problem"),
    [
        ({}, None),
        ({"keyUsage": "critical, keyCertSign, cRLSign"}, "digitalSignature"),
        ({"keyUsage": "critical, keyCertSign, nonRepudiation"}, None),
        ({"extendedKeyUsage": "serverAuth"}, "emailProtection"),
        ({"extendedKeyUsage": "serverAuth, emailProtection"}, None),
    ],
)
def test_authorities_that_may_sign_documents_as_openssl_sees_it(
    openssl, spec, extensions: dict[str, str], problem: str | None
) -> None:
    certificate = _authority(spec(**extensions)).certificate
    openssl.put(ca=certificates.to_pem(certificate))
    finding = certificates.can_sign_documents(certificate)
    if problem is None:
        assert finding is None
        openssl.accepts("verify", "-purpose", "smimesign", "-CAfile", "ca", "ca")
    else:
        assert finding is not None
        assert problem in finding.message
        openssl.refuses("verify", "-purpose", "smimesign", "-CAfile", "ca", "ca")


@pytest.mark.parametrize("pem", [b"", b"hello", b"-----BEGIN CERTIFICATE-----\nAAAA\n-----END CERTIFICATE-----\n"])
def test_what_is_no_certificate_is_an_error(pem: bytes) -> None:
    with pytest.raises(KeymintError, match="not a certificate") as caught:
        certificates.load(pem, Origin("public/ca.cert.pem"))
    assert str(caught.value).startswith("public/ca.cert.pem: ")
    assert not certificates.is_canonical(pem)


def test_times_of_other_zones_are_the_same_times(spec) -> None:
    from datetime import timezone

    zone = timezone(timedelta(hours=5))
    ca = _authority(spec(validity=Validity(datetime(2021, 1, 1, 5, tzinfo=zone), datetime(2030, 1, 1, 5, tzinfo=zone))))
    assert ca.certificate.not_valid_before_utc == datetime(2021, 1, 1, tzinfo=UTC)
