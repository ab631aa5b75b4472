# SPDX-License-Identifier: Apache-2.0
"""Detached signatures: made and verified, and refused if any byte of them or of the text is another."""

from __future__ import annotations

from dataclasses import replace

import pytest
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.serialization import pkcs7

from keymint.api import KeySpec
from keymint.pki import certificates, cms, der, keys

TEXT = b"Content-Type: text/plain\r\n\r\n<dds/>\r\n"
DETACHED = (pkcs7.PKCS7Options.DetachedSignature, pkcs7.PKCS7Options.Binary)


def signed(issuer: certificates.Issuer, digest: type[hashes.SHA256 | hashes.SHA384 | hashes.SHA512]) -> bytes:
    builder = pkcs7.PKCS7SignatureBuilder().set_data(TEXT).add_signer(issuer.certificate, issuer.key, digest())
    return builder.sign(serialization.Encoding.DER, DETACHED)


@pytest.mark.parametrize("kind", [KeySpec("ec", "SECP256R1"), KeySpec("ec", "SECP384R1"), KeySpec("rsa", size=2048)])
@pytest.mark.parametrize("digest", [hashes.SHA256, hashes.SHA384, hashes.SHA512])
def test_signatures_of_all_keys_and_digests_verify(spec, kind: KeySpec, digest) -> None:
    key = keys.generate(kind)
    issuer = certificates.Issuer(
        certificates.issue(spec("CN=ca", key=kind), key.public_key(), key, authority=True).certificate, key
    )
    signature = cms.parse(signed(issuer, digest))
    assert signature.digest == digest.name
    assert signature.certificate == issuer.certificate.public_bytes(serialization.Encoding.DER)
    assert cms.verify(signature, TEXT, issuer.certificate)
    assert not cms.verify(signature, TEXT + b" ", issuer.certificate)
    own = cms.parse(cms.sign(TEXT, issuer.certificate, issuer.key))
    assert own.digest == "sha256"
    assert cms.verify(own, TEXT, issuer.certificate)


@pytest.mark.parametrize(
    "kind", [KeySpec("ec", "SECP256R1"), KeySpec("ec", "SECP384R1"), KeySpec("rsa", size=2048)], ids=str
)
def test_a_signature_is_what_the_library_writes_but_for_the_time(spec, kind: KeySpec) -> None:
    key = keys.generate(kind)
    signer = certificates.issue(spec("CN=ca"), key.public_key(), key, authority=True).certificate
    options = [pkcs7.PKCS7Options.DetachedSignature, pkcs7.PKCS7Options.Binary, pkcs7.PKCS7Options.NoCapabilities]
    for number in range(20):  # the length of an ECDSA signature varies
        text = b"x" * number
        signed = cms.sign(text, signer, key)
        builder = pkcs7.PKCS7SignatureBuilder().set_data(text).add_signer(signer, key, hashes.SHA256())
        found, expected = (cms.parse(each) for each in (signed, builder.sign(serialization.Encoding.DER, options)))
        assert cms.verify(found, text, signer)
        assert not cms.verify(found, text + b"y", signer)
        assert replace(found, value=b"", attributes=b"") == replace(expected, value=b"", attributes=b"")
        content_type, _time, digest = der.elements(der.single(expected.attributes, der.SET))
        assert found.attributes == der.tlv(der.SET, content_type, digest)


def test_a_signature_is_of_its_certificate_only(authority: certificates.Issuer, other: certificates.Issuer) -> None:
    signature = cms.parse(cms.sign(TEXT, authority.certificate, authority.key))
    foreign = cms.parse(cms.sign(TEXT, other.certificate, other.key))
    assert not cms.verify(signature, TEXT, other.certificate)
    for part in ("certificate", "issuer_and_serial", "value"):
        assert not cms.verify(replace(signature, **{part: getattr(foreign, part)}), TEXT, authority.certificate)


def test_no_changed_byte_goes_unnoticed(authority: certificates.Issuer) -> None:
    signature = cms.sign(TEXT, authority.certificate, authority.key)
    for position in range(len(signature)):
        changed = bytearray(signature)
        changed[position] ^= 1
        try:
            verified = cms.verify(cms.parse(bytes(changed)), TEXT, authority.certificate)
        except ValueError:
            continue
        assert not verified, position


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ((pkcs7.PKCS7Options.Binary,), "contains the content"),
        ((*DETACHED, pkcs7.PKCS7Options.NoAttributes), "signed attributes"),
        ((*DETACHED, pkcs7.PKCS7Options.NoCerts), "one certificate"),
    ],
)
def test_other_forms_are_refused_with_the_reason(
    authority: certificates.Issuer, options: tuple[pkcs7.PKCS7Options, ...], reason: str
) -> None:
    builder = pkcs7.PKCS7SignatureBuilder().set_data(TEXT)
    builder = builder.add_signer(authority.certificate, authority.key, hashes.SHA256())
    with pytest.raises(ValueError, match=reason):
        cms.parse(builder.sign(serialization.Encoding.DER, options))


def test_several_signers_are_refused(authority: certificates.Issuer, other: certificates.Issuer) -> None:
    builder = pkcs7.PKCS7SignatureBuilder().set_data(TEXT)
    for issuer in (authority, other):
        builder = builder.add_signer(issuer.certificate, issuer.key, hashes.SHA256())
    with pytest.raises(ValueError, match="expected one"):
        cms.parse(builder.sign(serialization.Encoding.DER, DETACHED))


@pytest.mark.parametrize("junk", [b"", b"\x30", b"\x30\x80", b"\x30\x00", b"x" * 100, b"\x30\x84\xff\xff\xff\xff"])
def test_junk_is_a_value_error(junk: bytes) -> None:
    with pytest.raises(ValueError, match="expected"):
        cms.parse(junk)
