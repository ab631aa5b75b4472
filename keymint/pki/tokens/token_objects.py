# SPDX-License-Identifier: Apache-2.0
"""What tokens answer, for Keymint: public keys from their attributes, and their errors in words."""

from __future__ import annotations

import contextlib
from typing import Any, cast

import pkcs11
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec, rsa
from pkcs11 import Attribute, KeyType, ObjectClass
from pkcs11.util.ec import encode_named_curve_parameters

from keymint.errors import KeymintError, Origin
from keymint.pki import der, keys

_CURVES = {encode_named_curve_parameters(each.name): each for each in keys.CURVES.values()}
"""Curves by CKA_EC_PARAMS: the OID of a named curve in DER (PKCS #11, 2.3.3)."""
_LOST = (
    pkcs11.DeviceRemoved,
    pkcs11.TokenNotPresent,
    pkcs11.DeviceError,
    pkcs11.SessionHandleInvalid,
    pkcs11.SessionClosed,
    pkcs11.ObjectHandleInvalid,
    pkcs11.KeyHandleInvalid,
    pkcs11.UserNotLoggedIn,
)


def public_of(session: Any, key: Any, where: Origin | None) -> keys.PublicKey:
    """Return the public key of a private key in a token.

    Args:
        session: the session with the token.
        key: the private key.
        where: the place that names it, for messages.

    Raises:
        KeymintError: ``token-key-kind``: it is neither RSA nor EC on a known curve. ``token-key-missing``: the token
            has no public key or certificate beside it.
        pkcs11.PKCS11Error: the token refuses.
    """
    if key.key_type == KeyType.RSA:
        exponent, modulus = (int.from_bytes(key[each]) for each in (Attribute.PUBLIC_EXPONENT, Attribute.MODULUS))
        return rsa.RSAPublicNumbers(exponent, modulus).public_key()
    curve = _CURVES.get(bytes(key[Attribute.EC_PARAMS])) if key.key_type == KeyType.EC else None
    if curve is None:
        message = f"the token's key {key.label!r} is neither RSA nor EC on a known curve"
        raise KeymintError(message, where=where, help=f"known are {', '.join(keys.CURVES)}", code="token-key-kind")
    beside = {Attribute.ID: key.id} if key.id else {Attribute.LABEL: key.label}
    for public in session.get_objects(
        {Attribute.CLASS: ObjectClass.PUBLIC_KEY, Attribute.KEY_TYPE: KeyType.EC, **beside}
    ):
        return ec.EllipticCurvePublicKey.from_encoded_point(curve, _point(bytes(public[Attribute.EC_POINT]), curve))
    for certificate in session.get_objects({Attribute.CLASS: ObjectClass.CERTIFICATE, **beside}):
        with contextlib.suppress(ValueError):
            return cast("keys.PublicKey", x509.load_der_x509_certificate(certificate[Attribute.VALUE]).public_key())
    message = f"the token has no public key beside the private key {key.label!r}"
    help_ = "write it into the token with the same id: pkcs11-tool --write-object public.der --type pubkey --id …"
    raise KeymintError(message, where=where, help=help_, code="token-key-missing")


def token_error(error: pkcs11.PKCS11Error, token: str, where: Origin | None) -> KeymintError:
    """Return an error of a token in words.

    Args:
        error: the error.
        token: label or URI of the token.
        where: the place that names the key, for messages.
    """
    name = type(error).__name__
    code, message, help_ = "token-failed", f"the token {token} failed: {name}", "try it with pkcs11-tool --test --login"
    if isinstance(error, pkcs11.PinIncorrect | pkcs11.PinInvalid | pkcs11.PinLenRange):
        code, message = "token-pin", f"the PIN of the token {token} is wrong"
        help_ = "correct it; it was tried once, and tokens lock themselves after a few tries"
    elif isinstance(error, pkcs11.PinLocked | pkcs11.PinExpired | pkcs11.UserPinNotInitialized):
        state = {"PinLocked": "locked", "PinExpired": "expired"}.get(name, "not set")
        code, message = "token-pin", f"the PIN of the token {token} is {state}"
        help_ = "set it with the token's own tool"
    elif isinstance(error, _LOST):
        message = f"the token {token} was removed, or ended the session: {name}"
        help_ = "connect it, and run it again; nothing was written"
    elif isinstance(error, pkcs11.MechanismInvalid | pkcs11.KeyTypeInconsistent | pkcs11.KeySizeRange):
        code, message = "token-key-kind", f"the token {token} cannot sign with this key: {name}"
        help_ = "use an EC key, or RSA with PKCS #1 v1.5 and SHA-2"
    return KeymintError(message, where=where, help=help_, code=code)


def _point(value: bytes, curve: ec.EllipticCurve) -> bytes:
    """Return an uncompressed point: PKCS #11 wants it inside of an OCTET STRING, and some tokens leave that out."""
    return value if len(value) == 1 + 2 * ((curve.key_size + 7) // 8) else der.single(value, der.OCTET_STRING)
