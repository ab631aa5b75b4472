# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import pytest
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric import ec, ed25519, rsa

from comarmor.errors import Origin
from keymint.api import KeySpec
from keymint.errors import KeymintError
from keymint.pki import certificates, keys

HERE = Origin("private/ca.key.pem")
SPECS = [
    KeySpec("ec", "SECP256R1"),
    KeySpec("ec", "prime256v1"),
    KeySpec("ec", "SECP384R1"),
    KeySpec("ec", "P-521"),
    KeySpec("rsa", size=2048),
]


@pytest.mark.parametrize("spec", SPECS, ids=lambda spec: spec.curve or f"rsa{spec.size}")
@pytest.mark.parametrize("password", [None, b"correct horse"], ids=["clear", "encrypted"])
def test_openssl_accepts_every_key(openssl, spec: KeySpec, password: bytes | None) -> None:
    key = keys.generate(spec)
    pem = keys.to_pem(key, password)
    openssl.put(key=pem)
    openssl.accepts("pkey", "-in", "key", "-check", "-noout", "-passin", f"pass:{(password or b'').decode()}")
    assert (b"ENCRYPTED" in pem) == (password is not None)
    again = keys.from_pem(pem, password)
    assert again.public_key() == key.public_key()
    assert keys.fits(key, spec)
    assert keys.fits(key.public_key(), spec)
    assert keys.is_canonical(pem)


def test_a_key_of_another_kind_does_not_fit() -> None:
    p256, rsa = keys.generate(SPECS[0]), keys.generate(SPECS[4])
    assert not keys.fits(p256, SPECS[2])
    assert not keys.fits(p256, SPECS[4])
    assert not keys.fits(rsa, SPECS[0])
    assert not keys.fits(rsa, KeySpec("rsa", size=3072))


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        (KeySpec("ec", "SECP256K1"), "did you mean 'SECP256R1'?"),
        (KeySpec("ec", "SECP256"), "did you mean 'SECP256R1'?"),
        (KeySpec("ec", "__class__"), "known are SECP256R1"),
        (KeySpec("ec"), "not a supported curve"),
        (KeySpec("rsa", size=1024), "not between 2048"),
        (KeySpec("rsa", size=1 << 20), "not between 2048"),
        (KeySpec("dsa", size=2048), "known are ec"),
    ],
)
def test_unknown_keys_are_refused(spec: KeySpec, message: str) -> None:
    with pytest.raises(KeymintError, match=message) as caught:
        keys.generate(spec, HERE)
    assert caught.value.diagnostics[0].where == HERE


def test_passwords_are_asked_for_and_never_shown() -> None:
    pem = keys.to_pem(keys.generate(SPECS[0]), b"correct horse")
    for password, message in ((None, "no password is given"), (b"", "no password is given"), (b"wr0ng", "is wrong")):
        with pytest.raises(KeymintError, match=message) as caught:
            keys.from_pem(pem, password, HERE)
        assert caught.value.diagnostics[0].code == "key-password"
        assert "wr0ng" not in repr(caught.value) + str(caught.value)
        assert caught.value.__cause__ is None


def test_a_password_that_is_not_needed_does_no_harm() -> None:
    key = keys.generate(SPECS[0])
    assert keys.from_pem(keys.to_pem(key), b"needless").public_key() == key.public_key()


def test_damaged_files_are_errors_without_key_material(authority: certificates.Issuer) -> None:
    pem = keys.to_pem(authority.key)
    secret = pem.splitlines()[2].decode()
    public = certificates.to_pem(authority.certificate)
    for damaged in (b"", b"hello", pem[:-30], pem.replace(b"M", b"!"), public, pem.replace(b"\nMI", b"\nMA", 1)):
        with pytest.raises(KeymintError) as caught:
            keys.from_pem(damaged, None, HERE)
        assert secret not in repr(caught.value) + str(caught.value.diagnostics)
        assert str(caught.value).startswith("private/ca.key.pem: ")
    assert secret not in repr(authority)


def test_keys_of_other_algorithms_are_refused() -> None:
    from cryptography.hazmat.primitives import serialization
    from cryptography.hazmat.primitives.asymmetric import ed25519

    pem = ed25519.Ed25519PrivateKey.generate().private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )
    with pytest.raises(KeymintError, match="neither EC nor RSA"):
        keys.from_pem(pem)


def test_a_key_matches_its_own_certificate_only(authority: certificates.Issuer, other: certificates.Issuer) -> None:
    assert keys.matches(authority.key, authority.certificate)
    assert not keys.matches(authority.key, other.certificate)


@pytest.mark.parametrize("password", [None, b"pw"], ids=["clear", "encrypted"])
def test_every_changed_byte_of_a_key_file_is_found(authority: certificates.Issuer, password: bytes | None) -> None:
    pem = keys.to_pem(authority.key, password)
    assert keys.is_canonical(pem)
    for position in range(len(pem)):
        damaged = bytearray(pem)
        damaged[position] ^= 1
        assert _is_noticed(bytes(damaged), password, authority), position
    for damaged in (pem + b"\n", b"\n" + pem, pem[:-1], pem.replace(b"\n", b"\r\n"), pem + pem):
        assert not keys.is_canonical(damaged)


def test_the_form_of_a_file_is_known_after_its_public_key_was_read(authority: certificates.Issuer) -> None:
    pem = keys.to_pem(authority.key)
    for file, canonical in ((pem, True), (b"\n" + pem, False)):
        assert keys.public_of(file) == authority.key.public_key()
        assert keys.is_canonical(file) is canonical


def _is_noticed(pem: bytes, password: bytes | None, authority: certificates.Issuer) -> bool:
    if not keys.is_canonical(pem):
        return True
    try:
        key = keys.from_pem(pem, password)
    except KeymintError:
        return True
    return not keys.matches(key, authority.certificate)


def test_the_frame_of_an_encrypted_key_is_checked_without_its_password(authority: certificates.Issuer) -> None:
    pem = keys.to_pem(authority.key, b"pw")
    assert keys.is_canonical(pem)
    assert not keys.is_canonical(pem.replace(b"=", b"", 1) if b"=" in pem else pem + b" ")
    assert not keys.is_canonical(pem.replace(b"\n", b"", 2))


@pytest.mark.parametrize("spec", [KeySpec("ec", "SECP256R1"), KeySpec("rsa", size=2048)])
def test_the_public_key_of_a_file_is_that_of_its_private_key_each_time(spec: KeySpec) -> None:
    key = keys.generate(spec)
    plain, encrypted = keys.to_pem(key), keys.to_pem(key, b"secret")
    for _ in range(2):
        assert keys.public_of(plain) == key.public_key()
        assert keys.public_of(encrypted, b"secret") == key.public_key()
        with pytest.raises(KeymintError, match="password"):
            keys.public_of(encrypted, b"wrong")
        with pytest.raises(KeymintError, match="not a private key"):
            keys.public_of(plain.replace(b"M", b"!", 1))


@pytest.mark.parametrize(
    "key",
    [
        ec.derive_private_key(5, ec.SECP256R1()),
        ec.derive_private_key(5, ec.SECP384R1()),
        rsa.generate_private_key(65537, 2048),
    ],
)
def test_a_public_key_that_is_written_is_read_back(key: keys.PrivateKey) -> None:
    pem = keys.public_to_pem(key.public_key())
    assert pem.startswith(b"-----BEGIN PUBLIC KEY-----\n")
    assert keys.public_from_pem(pem) == key.public_key()


@pytest.mark.parametrize(
    "pem",
    [
        b"",
        b"\xff",
        ed25519.Ed25519PrivateKey.generate()
        .public_key()
        .public_bytes(serialization.Encoding.PEM, serialization.PublicFormat.SubjectPublicKeyInfo),
        ec.derive_private_key(5, ec.SECP256R1()).private_bytes(
            serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
        ),
    ],
    ids=["nothing", "no text", "another algorithm", "a private key"],
)
def test_what_is_no_public_key_is_refused_at_its_place(pem: bytes) -> None:
    with pytest.raises(KeymintError, match="not an EC or RSA public key") as error:
        keys.public_from_pem(pem, Origin("issuance.xml", 4))
    assert str(error.value.diagnostics[0]).startswith("issuance.xml:4")
    assert error.value.diagnostics[0].code == "public-key-invalid"
