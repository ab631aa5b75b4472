# SPDX-License-Identifier: Apache-2.0
"""Keys in tokens, as ``cryptography`` uses them; the token is one in software."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec, padding, utils

from comarmor.errors import Origin
from keymint.api import KeySpec, SigningAuthority
from keymint.errors import KeymintError
from keymint.pki import certificates, keys, smime
from keymint.pki.tokens import token_keys
from keymint.pki.tokens.token_sessions import Tokens
from tests.keymint.pki.conftest import Openssl, make_spec
from tests.softhsm import KINDS, PIN, SoftHsm

pytestmark = pytest.mark.softhsm
HERE = Origin("profile/authorities.xml", 9)
SPECS = {"P-256": KeySpec("ec", "SECP256R1"), "P-384": KeySpec("ec", "SECP384R1"), "RSA": KeySpec("rsa", size=2048)}


@pytest.fixture
def tokens() -> Iterator[Tokens]:
    opened = Tokens({}, lambda *_: PIN)
    yield opened
    opened.close()


def in_token(softhsm: SoftHsm, tokens: Tokens, kind: str = "P-256") -> keys.PrivateKey:
    spec = KeySpec("", uri=softhsm.make_key("identity_ca", kind=kind))
    return tokens.private_key(spec, tokens.public_key(spec, HERE), HERE)


@pytest.mark.parametrize("kind", KINDS)
def test_openssl_verifies_all_that_a_token_signs(softhsm: SoftHsm, tokens: Tokens, openssl: Openssl, kind: str) -> None:
    key = in_token(softhsm, tokens, kind)
    assert keys.fits(key, SPECS[kind])
    authority = certificates.issue(make_spec("CN=ca", key=SPECS[kind]), key.public_key(), key, authority=True)
    issuer = certificates.Issuer(authority.certificate, key)
    leaf = certificates.issue(
        make_spec("CN=/talker"), keys.generate(SPECS["P-256"]).public_key(), issuer, authority=False
    )
    signed = smime.sign(b"<dds/>\n", authority.certificate, key)
    builder = x509.CertificateRevocationListBuilder().issuer_name(authority.certificate.subject)
    moment = datetime(2026, 1, 1, tzinfo=UTC)
    revoked = x509.RevokedCertificateBuilder().serial_number(leaf.certificate.serial_number).revocation_date(moment)
    builder = builder.add_revoked_certificate(revoked.build())
    crl = builder.last_update(moment).next_update(datetime(2039, 1, 1, tzinfo=UTC)).sign(key, hashes.SHA256())
    openssl.put(ca=authority.pem, leaf=leaf.pem, doc=signed, crl=crl.public_bytes(serialization.Encoding.PEM))
    openssl.accepts("verify", "-CAfile", "ca", "leaf")
    openssl.accepts("smime", "-verify", "-text", "-CAfile", "ca", "-in", "doc")
    openssl.accepts("crl", "-in", "crl", "-CAfile", "ca", "-noout")
    assert b"revoked" in openssl.refuses("verify", "-crl_check", "-CRLfile", "crl", "-CAfile", "ca", "leaf")
    assert smime.verify(signed, authority.pem) == b"<dds/>\n"


def test_an_authority_in_a_token_is_a_signer(softhsm: SoftHsm, tokens: Tokens) -> None:
    key = in_token(softhsm, tokens)
    pem = certificates.issue(make_spec("CN=ca"), key.public_key(), key, authority=True).pem
    loaded = smime.load_signer(SigningAuthority("permissions_ca", pem, b"", token_key=key))
    assert loaded.key is key
    another = keys.generate(SPECS["P-256"])
    other = certificates.issue(make_spec("CN=ca"), another.public_key(), another, authority=True).pem
    with pytest.raises(KeymintError, match="does not belong to the certificate"):
        smime.load_signer(SigningAuthority("permissions_ca", other, b"", token_key=key))


def test_a_key_in_a_token_only_signs(softhsm: SoftHsm, tokens: Tokens) -> None:
    key = in_token(softhsm, tokens)
    assert copy.copy(key) is key
    assert copy.deepcopy(key) is key
    with pytest.raises(TypeError, match="stays in the process"):
        pickle.dumps(key)
    with pytest.raises(TypeError, match="only signs"):
        keys.to_pem(key)
    with pytest.raises(TypeError, match="only signs"):
        key.private_numbers()
    with pytest.raises(TypeError, match="signs data with ECDSA"):
        key.sign(bytes(32), ec.ECDSA(utils.Prehashed(hashes.SHA256())))


def test_an_rsa_key_in_a_token_signs_with_pkcs1_only(softhsm: SoftHsm, tokens: Tokens) -> None:
    key = in_token(softhsm, tokens, "RSA")
    with pytest.raises(TypeError, match=r"PKCS #1 v1\.5"):
        key.sign(b"data", padding.PSS(padding.MGF1(hashes.SHA256()), 32), hashes.SHA256())
    with pytest.raises(TypeError, match="SHA-2"):
        key.sign(b"data", padding.PKCS1v15(), hashes.SHA1())
    with pytest.raises(TypeError, match="only signs"):
        key.decrypt(b"data", padding.PKCS1v15())


@pytest.mark.parametrize("kind", ["P-256", "RSA"])
def test_the_key_of_another_certificate_signs_nothing(softhsm: SoftHsm, tokens: Tokens, kind: str) -> None:
    spec = KeySpec("", uri=softhsm.make_key("identity_ca", kind=kind))
    another = keys.generate(SPECS[kind])
    key = tokens.private_key(spec, another.public_key(), HERE)
    with pytest.raises(KeymintError, match="another key than the certificate") as error:
        certificates.issue(make_spec("CN=ca"), key.public_key(), key, authority=True)
    (found,) = error.value.diagnostics
    assert (found.code, found.where) == (token_keys.MISMATCH, HERE)


def test_a_signature_is_verified_before_it_leaves() -> None:
    wrong = keys.generate(SPECS["P-256"])

    def sign(digest: bytes, mechanism: str) -> bytes:
        assert (len(digest), mechanism) == (32, "ECDSA")
        return bytes(31) + b"\1" + bytes(31) + b"\1"

    with pytest.raises(KeymintError, match="another key"):
        token_keys.token_key(wrong.public_key(), sign).sign(b"data", ec.ECDSA(hashes.SHA256()))


def test_messages_name_no_pin(softhsm: SoftHsm, tokens: Tokens, tmp_path: Path) -> None:
    key = in_token(softhsm, tokens)
    assert PIN not in repr(key) + repr(vars(tokens)["_keys"]) + repr(tokens)
    assert not [file for file in tmp_path.rglob("*") if file.is_file() and PIN.encode() in file.read_bytes()]
