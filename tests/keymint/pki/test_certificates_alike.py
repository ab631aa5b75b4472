# SPDX-License-Identifier: Apache-2.0
"""Certificates that differ in name, key and serial number only: byte for byte those that the library writes."""

from __future__ import annotations

import random
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import pytest
from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import serialization

from keymint.api import CertificateSpec, KeySpec, Validity
from keymint.pki import certificate_forms, certificates, der, distinguished_names, keys
from keymint.pki.certificate_forms import CommonParts
from tests.effort import tries
from tests.keymint.pki.conftest import Openssl, make_spec, period

KINDS = (
    KeySpec("ec", "SECP256R1"),
    KeySpec("ec", "SECP384R1"),
    KeySpec("ec", "SECP521R1"),
    KeySpec("rsa", size=2048),
)
P256 = KINDS[0]
EXTENSIONS = {
    "keyUsage": ["critical, digitalSignature, keyAgreement", "nonRepudiation"],
    "extendedKeyUsage": ["serverAuth", "critical, clientAuth, 1.3.6.1.4.1.5"],
    "basicConstraints": ["critical, CA:FALSE", "CA:FALSE"],
    "subjectAltName": ["DNS:robot.example", f"URI:urn:{'r' * 200}, IP:::1"],
    "authorityKeyIdentifier": ["none", "keyid", "keyid, issuer:always"],
    "certificatePolicies": ["1.2.3.4, anyPolicy"],
    "crlDistributionPoints": ["URI:http://a.example/crl"],
    "authorityInfoAccess": ["OCSP;URI:http://a.example"],
    "nsComment": ["hello"],
    "1.3.6.1.4.1.9999.1": ["ASN1:UTF8:ä", "critical, DER:0500"],
}


def public(kind: KeySpec = P256) -> keys.PublicKey:
    return keys.generate(kind).public_key()


def new_authority(kind: KeySpec, subject: str = "CN=ca", last: int = 2090) -> certificates.Issuer:
    key, spec = keys.generate(kind), make_spec(subject, key=kind, validity=period(1980, last))
    return certificates.Issuer(certificates.issue(spec, key.public_key(), key, authority=True).certificate, key)


def random_subject(chosen: random.Random) -> str:
    values = ("/robot", "7", "Ünï/côde €", "a\\, b\\+c", "x" * 63, "a.b-c", "*@")
    parts = [f"{kind}={chosen.choice(values)}" for kind in chosen.sample(["CN", "OU", "O", "L", "ST", "UID"], 3)]
    parts += chosen.sample(["C=DE", "emailAddress=a@b.c", "DC=example", "serialNumber=12", "OU=1", "1.2.3.4=x"], 2)
    return ",".join(chosen.sample(parts, chosen.randint(1, len(parts))))


def random_spec(chosen: random.Random) -> CertificateSpec:
    first = datetime(2000, 1, 1, 12, 34, 56, 789, tzinfo=UTC) + timedelta(seconds=chosen.randrange(50 * 365 * 86_400))
    last = first + timedelta(seconds=chosen.choice([1, 86_400, 20 * 365 * 86_400]) * chosen.randint(1, 2))
    added = {name: chosen.choice(EXTENSIONS[name]) for name in chosen.sample(sorted(EXTENSIONS), chosen.randint(0, 3))}
    hash_algorithm = chosen.choice(["SHA256", "sha-384", "SHA512"])
    return make_spec("CN=first", validity=Validity(first, last), hash_algorithm=hash_algorithm, **added)


def filled(parts: CommonParts, subject: str, key: keys.PublicKey, issuer: certificates.Issuer) -> bytes:
    """Return a certificate in PEM that is made of the parts of another one."""
    content, serial = parts.fill(distinguished_names.parse(subject).public_bytes(), keys.public_der(key), issuer.key)
    pem = certificates.pem_of(content)
    assert certificates.load(pem).serial_number == serial
    return pem


def is_like(pem: bytes, parts: CommonParts, subject: str, key: keys.PublicKey, issuer: certificates.Issuer) -> bool:
    name = distinguished_names.written_name(subject).encoded
    return certificates.is_like(pem, parts, name, keys.public_der(key), issuer.certificate)


def parts_of(issued: certificates.Issued) -> CommonParts:
    parts = CommonParts.of(issued.certificate)
    assert parts is not None
    return parts


def test_they_are_what_the_library_writes(monkeypatch: pytest.MonkeyPatch, openssl: Openssl) -> None:
    chosen = random.Random(27)
    issuers = [
        new_authority(kind, name)
        for kind in KINDS
        for name in ("CN=ca", f"C=DE,O={'ö' * 32},ST={'s' * 128},CN=root/emailAddress=a@b.c")
    ]
    rsa = [public(KINDS[-1]) for _ in range(3)]
    monkeypatch.setattr(x509, "random_serial_number", lambda: chosen.getrandbits(chosen.randint(1, 159)) or 1)
    for case in range(tries(150, 10_000)):
        issuer, spec = chosen.choice(issuers), random_spec(chosen)
        parts = parts_of(certificates.issue(spec, public(), issuer, authority=False))
        kind = chosen.choice(KINDS)
        key, spec = (
            chosen.choice(rsa) if kind.size else public(kind),
            replace(spec, subject_name=random_subject(chosen)),
        )
        pem = filled(parts, spec.subject_name, key, issuer)
        certificate = certificates.load(pem)
        form = certificate_forms.form(spec, key, issuer.certificate, authority=False)
        theirs = by_library(form, certificate.serial_number, key, issuer.key)
        for ours in (certificate, form.signed(certificate.serial_number, key, issuer.key)):
            assert ours.tbs_certificate_bytes == theirs.tbs_certificate_bytes, spec
            assert framed(ours) == framed(theirs), spec
        assert pem == certificates.to_pem(certificate)
        assert form.diagnostics == ()
        certificate.verify_directly_issued_by(issuer.certificate)
        assert certificate.public_key() == key
        assert is_like(pem, parts, spec.subject_name, key, issuer)
        assert parts.is_same(CommonParts.of(certificate))
        if case % (tries(150, 10_000) // 15) == 0:
            openssl.put(ca=certificates.to_pem(issuer.certificate), identity=pem)
            openssl.accepts("verify", "-ignore_critical", "-no_check_time", "-CAfile", "ca", "identity")


def by_library(
    form: certificate_forms.Form, serial: int, key: keys.PublicKey, signer: keys.PrivateKey
) -> x509.Certificate:
    builder = (
        x509.CertificateBuilder()
        .issuer_name(form.issuer)
        .subject_name(form.subject)
        .public_key(key)
        .serial_number(serial)
        .not_valid_before(form.validity.not_before)
        .not_valid_after(form.validity.not_after)
    )
    for critical, value in form.extensions.values():
        builder = builder.add_extension(value, critical)
    return builder.sign(signer, form.hash_algorithm)


@pytest.mark.parametrize("kind", KINDS, ids=str)
@pytest.mark.parametrize("last", [2049, 2050, 9999])
def test_an_authority_is_what_the_library_writes(kind: KeySpec, last: int) -> None:
    key = keys.generate(kind)
    spec = make_spec("CN=ca", key=kind, validity=period(1950, last), hash_algorithm="SHA512")
    form = certificate_forms.form(spec, key.public_key(), None, authority=True)
    bare = replace(form, extensions={})
    for each in (form, bare):
        ours, theirs = each.signed(1, key.public_key(), key), by_library(each, 1, key.public_key(), key)
        assert ours.tbs_certificate_bytes == theirs.tbs_certificate_bytes
        assert framed(ours) == framed(theirs)
        assert (certificates.period(ours)) == (form.validity.not_before, form.validity.not_after)
        assert certificates.is_issued_by(ours, ours)


def test_a_year_that_a_certificate_cannot_have_is_no_other_year() -> None:
    key = keys.generate(P256)
    spec = make_spec(validity=period(1949, 2040))
    with pytest.raises(ValueError, match="1950"):
        certificate_forms.form(spec, key.public_key(), None, authority=True).signed(1, key.public_key(), key)


def is_issued(certificate: x509.Certificate, issuer: x509.Certificate) -> bool:
    try:
        certificate.verify_directly_issued_by(issuer)
    except (ValueError, TypeError, InvalidSignature):
        return False
    return True


@pytest.mark.parametrize("kind", [P256, KINDS[-1]], ids=str)
def test_an_altered_certificate_is_judged_as_by_the_library(kind: KeySpec) -> None:
    issuer = new_authority(kind)
    certificate = certificates.issue(make_spec("CN=/a"), public(), issuer, authority=False).certificate
    content = certificate.public_bytes(serialization.Encoding.DER)
    read = 0
    for place in range(len(content)):
        for bit in range(8):
            altered = content[:place] + bytes((content[place] ^ 1 << bit,)) + content[place + 1 :]
            try:
                found = x509.load_der_x509_certificate(altered)
                _ = found.issuer, found.signature_hash_algorithm
            except certificates.UNREADABLE:
                continue
            read += 1
            assert der.der_of(found) == found.public_bytes(serialization.Encoding.DER) == altered
            assert certificates.is_issued_by(found, issuer.certificate) == is_issued(found, issuer.certificate), (
                place,
                bit,
            )
    assert read > len(content)
    assert certificates.is_issued_by(certificate, issuer.certificate)


def test_an_issuer_must_have_the_name_and_the_key(authority: certificates.Issuer, other: certificates.Issuer) -> None:
    certificate = certificates.issue(make_spec("CN=/a"), public(), authority, authority=False).certificate
    assert certificates.is_issued_by(certificate, authority.certificate)
    assert not certificates.is_issued_by(certificate, other.certificate)
    renamed = make_spec(f"O=x,{authority.certificate.subject.rfc4514_string()}")
    same_key = certificates.issue(renamed, authority.key.public_key(), authority.key, authority=True).certificate
    assert not certificates.is_issued_by(certificate, same_key)
    assert not certificates.is_issued_by(authority.certificate, certificate)


def test_an_issuer_whose_key_is_no_point_issued_nothing(authority: certificates.Issuer) -> None:
    certificate = certificates.issue(make_spec("CN=/a"), public(), authority, authority=False).certificate
    content, key = der.der_of(authority.certificate), keys.public_der(authority.key.public_key())
    damaged = x509.load_der_x509_certificate(content.replace(key, key[:-1] + bytes((key[-1] ^ 1,))))
    with pytest.raises(ValueError, match="Invalid key"):
        damaged.public_key()
    assert not certificates.is_issued_by(certificate, damaged)


@pytest.mark.parametrize("kind", [P256, KINDS[-1]], ids=str)
def test_each_altered_byte_of_one_alike_is_found(kind: KeySpec) -> None:
    issuer, key = new_authority(kind), public()
    parts = parts_of(certificates.issue(make_spec("CN=/a"), public(), issuer, authority=False))
    pem = filled(parts, "CN=/b", key, issuer)
    assert is_like(pem, parts, "CN=/b", key, issuer)
    content = certificates.load(pem).public_bytes(serialization.Encoding.DER)
    for place in range(len(content)):
        altered = content[:place] + bytes((content[place] ^ 1 << place % 8,)) + content[place + 1 :]
        assert not is_like(certificates.pem_of(altered), parts, "CN=/b", key, issuer), place
    for other in (pem + b"\n", pem.replace(b"\n", b"\r\n"), pem[:-2], b"", pem.replace(b"CERT", b"cert")):
        assert not is_like(other, parts, "CN=/b", key, issuer)


def test_another_name_key_or_issuer_is_found(authority: certificates.Issuer, other: certificates.Issuer) -> None:
    key, first = public(), certificates.issue(make_spec("CN=/a"), public(), authority, authority=False)
    parts = parts_of(first)
    pem = filled(parts, "CN=/b", key, authority)
    assert is_like(pem, parts, "CN=/b", key, authority)
    assert not is_like(pem, parts, "CN=/a", key, authority)
    assert not is_like(pem, parts, "CN=/b", public(), authority)
    assert not is_like(pem, parts, "CN=/b", key, other)
    longer = certificates.issue(make_spec("CN=/b", validity=period(2021, 2080)), key, authority, authority=False)
    assert not is_like(longer.pem, parts, "CN=/b", key, authority)
    assert not parts.is_same(CommonParts.of(longer.certificate))


def framed(certificate: x509.Certificate) -> list[bytes]:
    """Return the two elements of a certificate before its signature, and the tag and unused bits of this."""
    content = der.single(certificate.public_bytes(serialization.Encoding.DER), der.SEQUENCE)
    body, algorithm, signature = der.elements(content)
    return [body, algorithm, signature[:1], der.single(signature, der.BIT_STRING)[:1]]


def test_serial_numbers_are_random_and_differ(authority: certificates.Issuer) -> None:
    parts = parts_of(certificates.issue(make_spec("CN=/a"), public(), authority, authority=False))
    serials = {certificates.load(filled(parts, "CN=/a", public(), authority)).serial_number for _ in range(50)}
    assert len(serials) == 50
    assert max(serials).bit_length() > 140


@pytest.mark.parametrize("identifier", ["0102", "none"])
def test_the_identifier_of_the_key_must_be_its_hash(authority: certificates.Issuer, identifier: str) -> None:
    spec = make_spec("CN=/a", subjectKeyIdentifier=identifier)
    assert CommonParts.of(certificates.issue(spec, public(), authority, authority=False).certificate) is None
