# SPDX-License-Identifier: Apache-2.0
"""The fields of issued certificates: defaults of the role, extensions that it must or must not have, and limits."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime

import pytest
from cryptography import x509

from comarmor.errors import Origin, Severity
from keymint.api import CertificateSpec, Extension, KeySpec, Validity
from keymint.errors import KeymintError
from keymint.pki import certificates, keys

P256 = KeySpec("ec", "SECP256R1")


def _authority(spec: CertificateSpec, issuer: certificates.Issuer | None = None) -> certificates.Issuer:
    key = keys.generate(spec.key)
    return certificates.Issuer(
        certificates.issue(spec, key.public_key(), issuer or key, authority=True).certificate, key
    )


def test_the_defaults_of_the_roles(spec, authority: certificates.Issuer) -> None:
    found = {each.oid._name: each for each in authority.certificate.extensions}
    assert set(found) == {"basicConstraints", "keyUsage", "subjectKeyIdentifier"}
    assert found["basicConstraints"].critical
    assert found["keyUsage"].critical
    identity = certificates.issue(spec("CN=/robot"), keys.generate(P256).public_key(), authority, authority=False)
    found = {each.oid._name: each for each in identity.certificate.extensions}
    assert set(found) == {
        "basicConstraints",
        "keyUsage",
        "extendedKeyUsage",
        "subjectKeyIdentifier",
        "authorityKeyIdentifier",
    }
    assert found["authorityKeyIdentifier"].value.key_identifier == (
        authority.certificate.extensions.get_extension_for_class(x509.SubjectKeyIdentifier).value.digest
    )
    assert x509.ExtendedKeyUsageOID.EMAIL_PROTECTION not in found["extendedKeyUsage"].value


@pytest.mark.parametrize(
    "value",
    ["emailProtection", "serverAuth, emailProtection", "anyExtendedKeyUsage", "1.3.6.1.5.5.7.3.4", "2.5.29.37.0"],
)
def test_an_identity_never_gets_to_sign_documents(spec, authority: certificates.Issuer, value: str) -> None:
    with pytest.raises(KeymintError, match="sign its own permissions") as caught:
        certificates.issue(
            spec("CN=/robot", extendedKeyUsage=value), keys.generate(P256).public_key(), authority, authority=False
        )
    assert caught.value.diagnostics[0].where == Origin("profile/authorities.xml", 20)


def test_the_back_door_of_a_dotted_oid_is_closed(spec, authority: certificates.Issuer) -> None:
    raw = Extension("2.5.29.37", "DER:300A06082B06010505070304", False, Origin("identities.xml", 5))
    with pytest.raises(KeymintError, match="write extendedKeyUsage"):
        certificates.issue(
            replace(spec("CN=/robot"), extensions=(raw,)), keys.generate(P256).public_key(), authority, authority=False
        )


@pytest.mark.parametrize(
    ("extensions", "message"),
    [
        ({"basicConstraints": "critical, CA:TRUE"}, "make an identity an authority"),
        ({"keyUsage": "keyCertSign"}, "issue certificates"),
        ({"keyUsag": "digitalSignature"}, "did you mean 'keyUsage'?"),
        ({"keyUsage": "digitalSignatur"}, "did you mean 'digitalSignature'?"),
    ],
)
def test_extensions_that_an_identity_must_not_have(
    spec, authority: certificates.Issuer, extensions: dict[str, str], message: str
) -> None:
    with pytest.raises(KeymintError) as caught:
        certificates.issue(
            spec("CN=/robot", **extensions), keys.generate(P256).public_key(), authority, authority=False
        )
    assert message in str(caught.value)
    assert str(caught.value).startswith("profile/authorities.xml:20: ")


@pytest.mark.parametrize(
    ("extensions", "message"),
    [
        ({"basicConstraints": "critical, CA:FALSE"}, "CA:TRUE for an authority"),
        ({"basicConstraints": "CA:TRUE"}, "must be critical"),
        ({"keyUsage": "critical, digitalSignature"}, "keyCertSign for an authority"),
    ],
)
def test_extensions_that_an_authority_must_have(spec, extensions: dict[str, str], message: str) -> None:
    with pytest.raises(KeymintError, match=message):
        _authority(spec(**extensions))


def test_a_given_extension_replaces_the_default(openssl, spec, authority: certificates.Issuer) -> None:
    issued = certificates.issue(
        spec("CN=/robot", keyUsage="critical, keyAgreement", subjectAltName="DNS:robot.local, URI:ros:/robot"),
        keys.generate(P256).public_key(),
        authority,
        authority=False,
    )
    openssl.put(ca=certificates.to_pem(authority.certificate), identity=issued.pem)
    openssl.accepts("verify", "-x509_strict", "-CAfile", "ca", "identity")
    text = openssl.run("x509", "-in", "identity", "-noout", "-text").stdout.decode()
    assert "Key Agreement" in text
    assert "Digital Signature" not in text
    assert "DNS:robot.local, URI:ros:/robot" in text


def test_validity_is_never_longer_than_the_issuers(spec, authority: certificates.Issuer) -> None:
    key = keys.generate(P256).public_key()
    long = Validity(datetime(2010, 1, 1, tzinfo=UTC), datetime(2060, 1, 1, 1, 2, 3, 999999, tzinfo=UTC))
    issued = certificates.issue(spec("CN=/robot", validity=long), key, authority, authority=False)
    assert issued.certificate.not_valid_before_utc == authority.certificate.not_valid_before_utc
    assert issued.certificate.not_valid_after_utc == authority.certificate.not_valid_after_utc
    (warning,) = issued.diagnostics
    assert (warning.code, warning.severity) == ("validity-clamped", Severity.WARNING)
    assert warning.where == Origin("profile/authorities.xml", 7)
    within = Validity(datetime(2021, 1, 1, tzinfo=UTC), datetime(2022, 1, 1, 1, 2, 3, 999999, tzinfo=UTC))
    issued = certificates.issue(spec("CN=/robot", validity=within), key, authority, authority=False)
    assert issued.diagnostics == ()
    assert issued.certificate.not_valid_after_utc == datetime(2022, 1, 1, 1, 2, 3, tzinfo=UTC)
    after = Validity(datetime(2050, 1, 1, tzinfo=UTC), datetime(2060, 1, 1, tzinfo=UTC))
    with pytest.raises(KeymintError, match="the validity is empty"):
        certificates.issue(spec("CN=/robot", validity=after), key, authority, authority=False)


def test_a_period_of_the_past_can_be_issued(spec) -> None:
    past = Validity(datetime(2013, 10, 26, tzinfo=UTC), datetime(2023, 10, 26, 22, 45, 30, tzinfo=UTC))
    ca = _authority(spec("CN=ca", validity=past, serial=1))
    assert ca.certificate.serial_number == 1
    issued = certificates.issue(spec("CN=talker", validity=past), keys.generate(P256).public_key(), ca, authority=False)
    assert issued.certificate.not_valid_after_utc == past.not_after


def test_serial_numbers(spec) -> None:
    seen = {_authority(spec()).certificate.serial_number for _ in range(20)}
    assert len(seen) == 20
    assert all(0 < serial < 1 << 159 for serial in seen)
    for serial in (0, -1, 1 << 159):
        with pytest.raises(KeymintError, match="serial number"):
            _authority(spec(serial=serial))


@pytest.mark.parametrize("name", ["MD5", "SHA1", "__class__", ""])
def test_weak_and_unknown_hashes_are_refused(spec, name: str) -> None:
    with pytest.raises(KeymintError, match="known are SHA256"):
        _authority(spec(hash_algorithm=name))


def test_an_issuer_must_be_one(spec, authority: certificates.Issuer) -> None:
    key = keys.generate(P256)
    identity = certificates.issue(spec("CN=/robot"), key.public_key(), authority, authority=False)
    with pytest.raises(KeymintError, match="basicConstraints lack CA:TRUE"):
        certificates.issue(
            spec("CN=/evil"), key.public_key(), certificates.Issuer(identity.certificate, key), authority=False
        )
