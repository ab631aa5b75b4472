# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import random
from dataclasses import replace
from datetime import UTC, datetime

import pytest
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.serialization import pkcs7
from hypothesis import HealthCheck, example, given, settings, strategies as st

from comarmor.errors import Origin
from keymint import api
from keymint.api import KeySpec
from keymint.errors import KeymintError
from keymint.pki import certificates, keys, smime

CONTENT = b'<?xml version="1.0"?>\n<dds>\n  <topic>rt/chatter</topic>\n\n  trailing  \n</dds>\n'
HERE = Origin("install/enclaves/talker/permissions.p7s")


def _sign(authority: certificates.Issuer, content: bytes = CONTENT) -> bytes:
    return smime.sign(content, authority.certificate, authority.key)


def _pem(authority: certificates.Issuer) -> bytes:
    return certificates.to_pem(authority.certificate)


@pytest.mark.parametrize(
    "kind",
    [KeySpec("ec", "SECP256R1"), KeySpec("ec", "SECP384R1"), KeySpec("rsa", size=2048)],
    ids=lambda spec: spec.curve or f"rsa{spec.size}",
)
def test_openssl_and_we_verify_what_is_signed(openssl, spec, kind: KeySpec) -> None:
    key = keys.generate(kind)
    ca = certificates.issue(spec("CN=permissions ca", key=kind), key.public_key(), key, authority=True)
    signed = smime.sign(CONTENT, ca.certificate, key)
    openssl.put(ca=ca.pem, signed=signed)
    openssl.accepts("smime", "-verify", "-text", "-in", "signed", "-CAfile", "ca", "-out", "content")
    assert (openssl.folder / "content").read_bytes().replace(b"\r\n", b"\n") == CONTENT
    # as the vendors do it: PKCS7_TEXT | PKCS7_NOVERIFY | PKCS7_NOINTERN, with the authority's certificate
    openssl.accepts("smime", "-verify", "-text", "-noverify", "-nointern", "-certfile", "ca", "-in", "signed")
    assert smime.verify(signed, ca.pem, at=datetime(2026, 1, 1, tzinfo=UTC)) == CONTENT
    assert smime.signed_content(signed) == CONTENT
    assert smime.is_current(signed, CONTENT, ca.certificate)


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.text(st.characters(codec="utf-8", exclude_characters="\r\0")).map(str.encode))
@example(b"")
@example(b"\n")
@example(b"no line end")
@example(b"two\n\n\n")
@example(b"Content-Type: text/html\n\n--x\n.\n")
@example(b"x" * 1022 + b"\n" + b"y" * 1023 + b"\n" + b"z" * 1024 + b"\n" + b"w" * 5000)
def test_any_text_survives_openssl(openssl, authority: certificates.Issuer, content: bytes) -> None:
    signed = _sign(authority, content)
    assert smime.verify(signed, _pem(authority)) == content
    openssl.put(ca=_pem(authority), signed=signed)
    openssl.accepts("smime", "-verify", "-text", "-in", "signed", "-CAfile", "ca", "-out", "content")
    shown = (openssl.folder / "content").read_bytes().replace(b"\r\n", b"\n")
    assert shown == content


@pytest.mark.parametrize(("content", "message"), [(b"<a>\r\n", "carriage return"), (b"<a>\n\0", "NUL byte")])
def test_what_does_not_survive_is_refused(authority: certificates.Issuer, content: bytes, message: str) -> None:
    with pytest.raises(KeymintError, match=message) as caught:
        smime.sign(content, authority.certificate, authority.key, Origin("build/permissions.xml"))
    assert str(caught.value).startswith(
        f"build/permissions.xml:{content.count(b'<a>') + (b'NUL' in message.encode())}: "
    )


def test_every_changed_byte_is_found(spec, authority: certificates.Issuer) -> None:
    rsa = KeySpec("rsa", size=2048)
    key = keys.generate(rsa)
    by_rsa = certificates.Issuer(
        certificates.issue(spec(key=rsa), key.public_key(), key, authority=True).certificate, key
    )
    for signer in (authority, by_rsa):
        signed = _sign(signer)
        for position in range(len(signed)):
            for mask in (0x01, random.Random(position).randrange(2, 256)):
                damaged = bytearray(signed)
                damaged[position] ^= mask
                with pytest.raises(KeymintError):
                    smime.verify(bytes(damaged), _pem(signer), where=HERE)


def test_added_and_missing_bytes_are_found(authority: certificates.Issuer) -> None:
    signed = _sign(authority)
    lines = signed.splitlines(keepends=True)
    damaged = [
        b"",
        b"\n" + signed,
        signed.replace(b"text/plain", b"text/html "),
        signed.replace(b"\n\n<?xml", b"\nX-Header: 1\n\n<?xml"),
        signed.replace(b"</dds>\n", b"</dds>\n\n"),
        *(b"".join(lines[:index] + lines[index + 1 :]) for index in range(len(lines))),
        *(b"".join([*lines[: index + 1], *lines[index:]]) for index in range(len(lines))),
        *(signed[:length] for length in range(0, len(signed), 7)),
    ]
    crlf = signed.replace(b"\n", b"\r\n")
    harmless = {signed[:-2], signed[:-1], signed, signed + b"\n", signed + b"\n\n", crlf, crlf[:-2], crlf + b"\r\n"}
    for each in harmless:
        assert smime.verify(each, _pem(authority)) == CONTENT
    for each in set(damaged) - harmless:
        with pytest.raises(KeymintError) as caught:
            smime.verify(each, _pem(authority), where=HERE)
        assert caught.value.diagnostics[0].code in {"smime-form", "smime-altered"}
        assert caught.value.diagnostics[0].where is not None
        assert caught.value.diagnostics[0].where.file == HERE.file


@given(st.binary(min_size=1, max_size=200))
def test_junk_in_the_frame_is_an_error_of_ours(junk: bytes) -> None:
    assert smime.signed_content(smime.wrap(b"content\n", junk)) == b"content\n"
    with pytest.raises(KeymintError):
        smime.verify(smime.wrap(b"content\n", junk), _pem_of_nobody())
    with pytest.raises(KeymintError):
        smime.signed_content(junk)


def _pem_of_nobody() -> bytes:
    return b"-----BEGIN CERTIFICATE-----\n-----END CERTIFICATE-----\n"


@given(cut=st.tuples(st.integers(0, 700), st.integers(0, 700)), patch=st.binary(max_size=8))
@settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_signature_cut_or_spliced_anywhere_is_refused(
    authority: certificates.Issuer, cut: tuple[int, int], patch: bytes
) -> None:
    document = smime.unwrap(_sign(authority))
    content, signature = document.content, document.signature
    spliced = signature[: min(cut)] + patch + signature[max(cut) :]
    if spliced != signature:
        with pytest.raises(KeymintError):
            smime.verify(smime.wrap(content, spliced), _pem(authority))
        assert not smime.is_current(smime.wrap(content, spliced), content, authority.certificate)


def test_another_signer_is_found(authority: certificates.Issuer, other: certificates.Issuer) -> None:
    signed = _sign(other)
    with pytest.raises(KeymintError, match="another certificate") as caught:
        smime.verify(signed, _pem(authority), where=HERE)
    assert caught.value.diagnostics[0].code == "smime-signer"
    assert not smime.is_current(signed, CONTENT, authority.certificate)


def test_a_forged_signer_certificate_does_not_help(authority: certificates.Issuer, other: certificates.Issuer) -> None:
    forged = smime.sign(CONTENT, authority.certificate, other.key)  # the right name, the wrong key
    assert not smime.is_current(forged, CONTENT, authority.certificate)
    with pytest.raises(KeymintError, match="signature is invalid"):
        smime.verify(forged, _pem(authority))


def test_an_identity_cannot_sign_permissions(openssl, spec, authority: certificates.Issuer) -> None:
    """CVE-2023-24010: under one authority for both jobs, an identity's key signed its own permissions."""
    key = keys.generate(KeySpec("ec", "SECP256R1"))
    identity = certificates.issue(spec("CN=/evil"), key.public_key(), authority, authority=False)
    forged = smime.sign(CONTENT, identity.certificate, key)
    openssl.put(ca=_pem(authority), forged=forged)
    error = openssl.refuses("smime", "-verify", "-text", "-in", "forged", "-CAfile", "ca")
    assert b"purpose" in error
    with pytest.raises(KeymintError, match="another certificate"):
        smime.verify(forged, _pem(authority))
    with pytest.raises(KeymintError, match="cannot sign documents"):
        smime.verify(forged, identity.pem)


def test_an_authority_must_be_allowed_and_valid(spec, authority: certificates.Issuer) -> None:
    key = keys.generate(KeySpec("ec", "SECP256R1"))
    weak = certificates.issue(spec(keyUsage="critical, keyCertSign"), key.public_key(), key, authority=True)
    with pytest.raises(KeymintError, match="keyUsage lacks digitalSignature"):
        smime.verify(smime.sign(CONTENT, weak.certificate, key), weak.pem)
    signed = _sign(authority)
    for year in (2019, 2041):
        with pytest.raises(KeymintError, match="valid from 2020-01-01 to 2040-01-01"):
            smime.verify(signed, _pem(authority), at=datetime(year, 6, 1, tzinfo=UTC))


def test_signatures_of_other_forms_are_refused(authority: certificates.Issuer) -> None:
    text = smime.canonical_text(CONTENT)
    options = pkcs7.PKCS7Options
    forms = [
        (hashes.SHA512(), [options.DetachedSignature, options.Binary]),
        (hashes.SHA256(), [options.Binary]),
        (hashes.SHA256(), [options.DetachedSignature, options.Binary, options.NoAttributes]),
        (hashes.SHA256(), [options.DetachedSignature, options.Binary, options.NoCerts]),
    ]
    for algorithm, chosen in forms:
        builder = (
            pkcs7.PKCS7SignatureBuilder().set_data(text).add_signer(authority.certificate, authority.key, algorithm)
        )
        raw = builder.sign(serialization.Encoding.DER, chosen)
        with pytest.raises(KeymintError):
            smime.verify(smime.wrap(CONTENT, raw), _pem(authority))


def test_of_the_same_content_everything_but_the_signature_is_the_same(authority: certificates.Issuer) -> None:
    first, second = (_sign(authority).split(b"base64\n") for _ in range(2))
    assert first[0] == second[0]


def test_a_signer_is_loaded_once_and_keeps_its_secrets(authority: certificates.Issuer) -> None:
    pem = keys.to_pem(authority.key, b"correct horse")
    signer = api.SigningAuthority("permissions_ca", _pem(authority), pem, b"correct horse")
    loaded = smime.load_signer(signer)
    assert smime.load_signer(replace(signer)) is loaded
    assert smime.verify(smime.sign(CONTENT, loaded.certificate, loaded.key), _pem(authority)) == CONTENT
    assert "horse" not in repr(signer) + repr(loaded)
    assert "key=" not in repr(loaded)


def test_a_signer_whose_key_is_anothers_is_refused(authority: certificates.Issuer, other: certificates.Issuer) -> None:
    with pytest.raises(KeymintError, match="authority permissions_ca: the private key does not belong"):
        smime.load_signer(api.SigningAuthority("permissions_ca", _pem(authority), keys.to_pem(other.key)))
