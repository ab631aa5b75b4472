# SPDX-License-Identifier: Apache-2.0
"""Keys in DER and PEM: public ones as SubjectPublicKeyInfo (RFC 5280, 4.1.2.7), private ones as PKCS #8 (RFC 5958).

An EC key in exactly the form that the library writes is encoded and decoded here, every other one by the library. Its
module loads the readers of all formats, those of SSH keys among them, which takes a thirtieth of a small run.
"""

from __future__ import annotations

import functools
from binascii import a2b_base64
from contextlib import suppress
from typing import cast

from cryptography.hazmat.primitives.asymmetric import ec, rsa

from keymint.pki import der

PrivateKey = ec.EllipticCurvePrivateKey | rsa.RSAPrivateKey
PublicKey = ec.EllipticCurvePublicKey | rsa.RSAPublicKey

_EC_KEY = "1.2.840.10045.2.1"
"""id-ecPublicKey (RFC 5480, 2.1.1)."""
_CURVES = {
    der.tlv(der.SEQUENCE, der.oid(_EC_KEY), der.oid(each.dotted_string)): ec.get_curve_for_oid(each)()
    for each in (ec.EllipticCurveOID.SECP256R1, ec.EllipticCurveOID.SECP384R1, ec.EllipticCurveOID.SECP521R1)
}
"""Curves by the AlgorithmIdentifier of their keys."""
_ALGORITHMS = {curve.name: algorithm for algorithm, curve in _CURVES.items()}
_ZERO, _ONE = (der.tlv(der.INTEGER, bytes((number,))) for number in (0, 1))


def public_der(key: PublicKey) -> bytes:
    """Return a public key in DER; equal keys give equal bytes."""
    if isinstance(key, ec.EllipticCurvePublicKey) and key.curve.name in _ALGORITHMS:
        return der.tlv(der.SEQUENCE, _ALGORITHMS[key.curve.name], _point(key))
    from cryptography.hazmat.primitives import serialization  # noqa: PLC0415 - slow, see above

    return key.public_bytes(serialization.Encoding.DER, serialization.PublicFormat.SubjectPublicKeyInfo)


@functools.lru_cache(maxsize=1 << 12)
def load_public_der(encoded: bytes) -> PublicKey:
    """Return the public key that :func:`public_der` encoded."""
    algorithm, point = der.elements(der.single(encoded, der.SEQUENCE))
    if curve := _CURVES.get(algorithm):
        return ec.EllipticCurvePublicKey.from_encoded_point(curve, der.single(point, der.BIT_STRING)[1:])
    from cryptography.hazmat.primitives import serialization  # noqa: PLC0415 - slow, see above

    return cast("PublicKey", serialization.load_der_public_key(encoded))


def private_pem(key: PrivateKey, password: bytes | None = None) -> bytes:
    """Return a private key as PKCS #8 PEM, encrypted (PBES2, AES-256) if a password is given."""
    if not password and isinstance(key, ec.EllipticCurvePrivateKey) and key.curve.name in _ALGORITHMS:
        value = key.private_numbers().private_value.to_bytes((key.key_size + 7) // 8, "big")
        public = der.tlv(der.CONTEXT_1, _point(key.public_key()))
        own = der.tlv(der.SEQUENCE, _ONE, der.tlv(der.OCTET_STRING, value), public)  # RFC 5915, section 3
        encoded = der.tlv(der.SEQUENCE, _ZERO, _ALGORITHMS[key.curve.name], der.tlv(der.OCTET_STRING, own))
        return der.pem(b"PRIVATE KEY", encoded)
    from cryptography.hazmat.primitives import serialization  # noqa: PLC0415 - slow, see above

    encryption = serialization.BestAvailableEncryption(password) if password else serialization.NoEncryption()
    return key.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, encryption)


def load_private_pem(pem: bytes, password: bytes | None) -> object:
    """Return the private key of any kind that a PEM file has.

    Raises:
        ValueError, TypeError, UnsupportedAlgorithm: as the library's ``load_pem_private_key``.
    """
    if key := _load_own_form(pem):
        return key
    from cryptography.hazmat.primitives import serialization  # noqa: PLC0415 - slow, see above

    return serialization.load_pem_private_key(pem, password)


def _load_own_form(pem: bytes) -> ec.EllipticCurvePrivateKey | None:
    """Return the EC key of a file; None unless the file is exactly what :func:`private_pem` writes for it."""
    with suppress(ValueError):
        encoded = a2b_base64(b"".join(pem.split(b"\n")[1:-2]))
        _, algorithm, octets = der.elements(der.single(encoded, der.SEQUENCE))
        _, value, _ = der.elements(der.single(der.single(octets, der.OCTET_STRING), der.SEQUENCE))
        if curve := _CURVES.get(algorithm):
            key = ec.derive_private_key(int.from_bytes(der.single(value, der.OCTET_STRING), "big"), curve)
            return key if private_pem(key) == pem else None
    return None


def _point(key: ec.EllipticCurvePublicKey) -> bytes:
    """Return the point of a key, uncompressed, as a BIT STRING (SEC 1, 2.3.3)."""
    numbers, size = key.public_numbers(), (key.key_size + 7) // 8
    return der.tlv(der.BIT_STRING, b"\0\4", numbers.x.to_bytes(size, "big"), numbers.y.to_bytes(size, "big"))
