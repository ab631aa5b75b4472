# SPDX-License-Identifier: Apache-2.0
"""Keys are encoded and decoded as the library does it, byte for byte, and what it refuses is refused."""

from __future__ import annotations

import random

import pytest
from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric import ec, rsa

from keymint.pki import der, key_encodings
from tests.effort import tries

CURVES = (ec.SECP256R1(), ec.SECP384R1(), ec.SECP521R1(), ec.SECP256K1(), ec.BrainpoolP256R1())
DER, PEM = serialization.Encoding.DER, serialization.Encoding.PEM
PKCS8, SPKI = serialization.PrivateFormat.PKCS8, serialization.PublicFormat.SubjectPublicKeyInfo
CLEAR = serialization.NoEncryption()


def by_library(pem: bytes) -> int | None:
    """Return the private value of an EC key, if the library reads one."""
    try:
        key = serialization.load_pem_private_key(pem, None)
    except (ValueError, TypeError, UnsupportedAlgorithm):
        return None
    return key.private_numbers().private_value if isinstance(key, ec.EllipticCurvePrivateKey) else None


def by_keymint(pem: bytes) -> int | None:
    try:
        key = key_encodings.load_private_pem(pem, None)
    except (ValueError, TypeError, UnsupportedAlgorithm):
        return None
    return key.private_numbers().private_value if isinstance(key, ec.EllipticCurvePrivateKey) else None


@pytest.mark.parametrize("curve", CURVES, ids=lambda curve: curve.name)
def test_ec_keys(curve: ec.EllipticCurve) -> None:
    chosen = random.Random(27)
    few = [1, 2, 255, 1 << 64, (1 << curve.key_size - 9) - 1]  # shorter than the curve: zeros come first
    for value in few + [chosen.randrange(1, 1 << curve.key_size - 1) for _ in range(tries(40, 10_000))]:
        key = ec.derive_private_key(value, curve)
        pem = key_encodings.private_pem(key)
        assert pem == key.private_bytes(PEM, PKCS8, CLEAR)
        assert by_keymint(pem) == value
        public = key_encodings.public_der(key.public_key())
        assert public == key.public_key().public_bytes(DER, SPKI)
        assert key_encodings.load_public_der(public) == key.public_key()


def test_rsa_keys() -> None:
    key = rsa.generate_private_key(65537, 2048)
    pem, public = key_encodings.private_pem(key), key_encodings.public_der(key.public_key())
    assert pem == key.private_bytes(PEM, PKCS8, CLEAR)
    assert public == key.public_key().public_bytes(DER, SPKI)
    loaded = key_encodings.load_private_pem(pem, None)
    assert isinstance(loaded, rsa.RSAPrivateKey)
    assert loaded.private_numbers() == key.private_numbers()
    assert key_encodings.load_public_der(public) == key.public_key()


@pytest.mark.parametrize("curve", CURVES[:3], ids=lambda curve: curve.name)
@pytest.mark.parametrize("part", ["zero", "order", "order + 1", "largest", "of another key"])
def test_a_private_value_that_is_none_is_refused(curve: ec.EllipticCurve, part: str) -> None:
    order = curve.group_order
    key, size = ec.derive_private_key(order - 1, curve), (curve.key_size + 7) // 8
    values = {"zero": 0, "order": order, "order + 1": order + 1, "largest": (1 << 8 * size) - 1, "of another key": 5}
    content = der.elements(der.single(key.private_bytes(DER, PKCS8, CLEAR), der.SEQUENCE))
    number, _, public = der.elements(der.single(der.single(content[2], der.OCTET_STRING), der.SEQUENCE))
    own = der.tlv(der.SEQUENCE, number, der.tlv(der.OCTET_STRING, values[part].to_bytes(size, "big")), public)
    pem = der.pem(b"PRIVATE KEY", der.tlv(der.SEQUENCE, *content[:2], der.tlv(der.OCTET_STRING, own)))
    assert by_library(pem) is None
    assert by_keymint(pem) is None


@pytest.mark.parametrize("curve", CURVES[:3], ids=lambda curve: curve.name)
def test_each_altered_bit_is_read_as_by_the_library(curve: ec.EllipticCurve) -> None:
    content = ec.derive_private_key(77, curve).private_bytes(DER, PKCS8, CLEAR)
    for place in range(8 * len(content)):
        altered = bytearray(content)
        altered[place // 8] ^= 1 << place % 8
        pem = der.pem(b"PRIVATE KEY", bytes(altered))
        assert by_keymint(pem) == by_library(pem), place


def test_other_forms_of_the_same_key_are_read() -> None:
    key = ec.derive_private_key(77, ec.SECP256R1())
    pem = key_encodings.private_pem(key)
    traditional = key.private_bytes(PEM, serialization.PrivateFormat.TraditionalOpenSSL, CLEAR)
    for other in (traditional, b"text before\n" + pem, pem.replace(b"\n", b"\r\n"), pem + b"\n", pem[:-1]):
        assert by_keymint(other) == by_library(other) == 77
    password = b"correct horse"
    assert by_keymint(key_encodings.private_pem(key, password)) is None
    loaded = key_encodings.load_private_pem(key_encodings.private_pem(key, password), password)
    assert isinstance(loaded, ec.EllipticCurvePrivateKey)
    assert loaded.private_numbers() == key.private_numbers()
