# SPDX-License-Identifier: Apache-2.0
"""Certificates that differ in name, key and serial number only: byte for byte those that the library writes."""

from __future__ import annotations

import random
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec, utils

from comarmor.errors import Origin
from keymint.api import CertificateSpec, KeySpec, Validity
from keymint.errors import KeymintError
from keymint.pki import certificate_forms, certificates, der, keys
from keymint.pki.tokens.token_keys import token_key
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


@contextmanager
def without_the_library() -> Iterator[None]:
    """Fail where the library writes a certificate."""

    def never(*_: object) -> None:
        raise AssertionError("the library wrote it")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(certificate_forms.Form, "signed", never)
        yield


@pytest.fixture(autouse=True)
def _none_is_known(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(certificates, "_TEMPLATES", {})


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
        certificates.issue(spec, public(), issuer, authority=False)
        kind = chosen.choice(KINDS)
        key, spec = (
            chosen.choice(rsa) if kind.size else public(kind),
            replace(spec, subject_name=random_subject(chosen)),
        )
        with without_the_library():
            issued = certificates.issue(spec, key, issuer, authority=False)
        form = certificate_forms.form(spec, key, issuer.certificate, authority=False)
        theirs = form.signed(issued.certificate.serial_number, key, issuer.key)
        assert issued.certificate.tbs_certificate_bytes == theirs.tbs_certificate_bytes, spec
        assert framed(issued.certificate) == framed(theirs), spec
        assert issued.pem == certificates.to_pem(issued.certificate)
        assert issued.diagnostics == form.diagnostics == ()
        issued.certificate.verify_directly_issued_by(issuer.certificate)
        assert issued.certificate.public_key() == key
        if case % (tries(150, 10_000) // 15) == 0:
            openssl.put(ca=certificates.to_pem(issuer.certificate), identity=issued.pem)
            openssl.accepts("verify", "-ignore_critical", "-no_check_time", "-CAfile", "ca", "identity")


def framed(certificate: x509.Certificate) -> list[bytes]:
    """Return the two elements of a certificate before its signature, and the tag and unused bits of this."""
    content = der.single(certificate.public_bytes(serialization.Encoding.DER), der.SEQUENCE)
    body, algorithm, signature = der.elements(content)
    return [body, algorithm, signature[:1], der.single(signature, der.BIT_STRING)[:1]]


def test_serial_numbers_are_random_and_differ(authority: certificates.Issuer) -> None:
    issued = [certificates.issue(make_spec("CN=/a"), public(), authority, authority=False) for _ in range(50)]
    serials = {each.certificate.serial_number for each in issued}
    assert len(serials) == 50
    assert max(serials).bit_length() > 140


def test_each_authority_has_its_own(authority: certificates.Issuer, other: certificates.Issuer) -> None:
    for issuer in (authority, other, authority, other):
        issued = certificates.issue(make_spec("CN=/a"), public(), issuer, authority=False)
        issued.certificate.verify_directly_issued_by(issuer.certificate)
        found = issued.certificate.extensions.get_extension_for_class(x509.AuthorityKeyIdentifier).value
        own = issuer.certificate.extensions.get_extension_for_class(x509.SubjectKeyIdentifier).value
        assert found.key_identifier == own.digest


@pytest.mark.parametrize(
    "changed",
    [
        {"serial": 7},
        {"subjectKeyIdentifier": "hash"},
        {"subjectKeyIdentifier": "0102"},
        {"subjectKeyIdentifier": "none"},
        {"validity": period(2030, 2091)},
    ],
    ids=str,
)
def test_the_library_writes_the_others(authority: certificates.Issuer, changed: dict[str, object]) -> None:
    """Also a certificate whose end is cut, of which each is warned."""
    for name in ("CN=/a", "CN=/b"):
        spec, key = make_spec(name, **changed), public()  # type: ignore[arg-type]
        issued = certificates.issue(spec, key, authority, authority=False)
        assert certificates.certificate_satisfies(issued.pem, spec, key, authority.certificate, authority=False)
        assert len(issued.diagnostics) == ("validity" in changed)
    assert certificates._TEMPLATES == {}


def test_the_library_writes_authorities_and_what_a_token_signs(authority: certificates.Issuer) -> None:
    key = keys.generate(P256)

    def sign(digest: bytes, _: str) -> bytes:
        first, second = utils.decode_dss_signature(key.sign(digest, ec.ECDSA(utils.Prehashed(hashes.SHA256()))))
        return first.to_bytes(32, "big") + second.to_bytes(32, "big")

    in_token = token_key(key.public_key(), sign)
    of_token = certificates.issue(make_spec("CN=ca"), in_token.public_key(), in_token, authority=True)
    issuer = certificates.Issuer(of_token.certificate, in_token)
    for _ in range(2):
        certificates.issue(make_spec("CN=/a"), public(), issuer, authority=False)
        certificates.issue(make_spec("CN=middle"), public(), authority, authority=True)
    assert certificates._TEMPLATES == {}


def test_what_is_remembered_has_a_bound(authority: certificates.Issuer) -> None:
    begin = datetime(2021, 1, 1, tzinfo=UTC)
    for seconds in range(2 * certificates._MOST_TEMPLATES):
        spec = make_spec("CN=/a", validity=Validity(begin, begin + timedelta(days=1, seconds=seconds)))
        certificates.issue(spec, public(), authority, authority=False)
    assert len(certificates._TEMPLATES) <= certificates._MOST_TEMPLATES


def test_a_wrong_name_is_reported_where_it_stands(authority: certificates.Issuer) -> None:
    certificates.issue(make_spec("CN=/a"), public(), authority, authority=False)
    wrong = replace(make_spec("CN=/b,X=1"), origin=Origin("src/b/identities.xml", 3))
    with without_the_library(), pytest.raises(KeymintError, match="not an attribute type") as caught:
        certificates.issue(wrong, public(), authority, authority=False)
    assert caught.value.diagnostics[0].where == Origin("src/b/identities.xml", 3)
