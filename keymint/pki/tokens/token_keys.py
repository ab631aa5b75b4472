# SPDX-License-Identifier: Apache-2.0
"""Private keys in a token: ``cryptography`` takes them wherever it takes a key, and the token signs.

They sign and tell their public key, and nothing else: a token returns no private key.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from typing import Any, Generic, NoReturn, Self, TypeVar

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric import ec, rsa, utils
from cryptography.hazmat.primitives.asymmetric.padding import AsymmetricPadding, PKCS1v15

from keymint.errors import KeymintError, Origin
from keymint.pki import keys

_Public = TypeVar("_Public", ec.EllipticCurvePublicKey, rsa.RSAPublicKey)
Sign = Callable[[bytes, str], bytes]
"""Signs with a token: takes what it signs and a mechanism of PKCS #11, e.g. ``ECDSA``, and returns the signature."""
_RSA_MECHANISMS = {"sha256": "SHA256_RSA_PKCS", "sha384": "SHA384_RSA_PKCS", "sha512": "SHA512_RSA_PKCS"}
MISMATCH = "token-key-mismatch"
"""Code of the error on a token that has another key than the certificate."""


class _TokenKey(Generic[_Public]):
    """What the keys of both algorithms have in common.

    Args:
        public: its public key, with which each signature is verified.
        sign: signs with the token.
        where: the place that names the key, for messages.
    """

    def __init__(self, public: _Public, sign: Sign, where: Origin | None = None) -> None:
        self._public: _Public = public
        self._sign = sign
        self._where = where

    @property
    def key_size(self) -> int:
        """The bits of its curve or modulus."""
        return self._public.key_size

    def public_key(self) -> _Public:
        """Return its public key."""
        return self._public

    def _verified(self, signature: bytes, *how: Any) -> bytes:
        try:
            self._public.verify(signature, *how)
        except InvalidSignature:
            raise mismatch(self._where) from None
        return signature

    def __copy__(self) -> Self:
        return self

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        return self

    def __reduce__(self) -> NoReturn:
        raise TypeError("a key in a token stays in the process that opened its session")

    def _refuse(self, *_: Any, **__: Any) -> NoReturn:
        """Refuse: a token returns no private key, and Keymint only signs with it."""
        raise TypeError("a key in a token only signs")

    private_numbers = private_bytes = exchange = decrypt = _refuse


class TokenEcKey(_TokenKey[ec.EllipticCurvePublicKey], ec.EllipticCurvePrivateKey):
    """A private EC key in a token."""

    @property
    def curve(self) -> ec.EllipticCurve:
        """Its curve."""
        return self._public.curve

    def sign(self, data: Any, signature_algorithm: ec.EllipticCurveSignatureAlgorithm) -> bytes:
        """Return the ECDSA signature of data in DER (RFC 3279, 2.2.3).

        Raises:
            KeymintError: the token refuses, or has another key.
        """
        algorithm = signature_algorithm.algorithm
        if not isinstance(signature_algorithm, ec.ECDSA) or isinstance(algorithm, utils.Prehashed):
            raise TypeError("a key in a token signs data with ECDSA")
        raw = self._sign(hashlib.new(algorithm.name, data).digest(), "ECDSA")
        half = len(raw) // 2
        signature = utils.encode_dss_signature(int.from_bytes(raw[:half]), int.from_bytes(raw[half:]))
        return self._verified(signature, data, ec.ECDSA(algorithm))


class TokenRsaKey(_TokenKey[rsa.RSAPublicKey], rsa.RSAPrivateKey):
    """A private RSA key in a token."""

    def sign(self, data: Any, padding: AsymmetricPadding, algorithm: Any) -> bytes:
        """Return the RSASSA-PKCS1-v1_5 signature of data (RFC 8017, 8.2); errors as :meth:`TokenEcKey.sign`."""
        mechanism = _RSA_MECHANISMS.get(getattr(algorithm, "name", ""))
        if not isinstance(padding, PKCS1v15) or mechanism is None:
            raise TypeError("an RSA key in a token signs data with PKCS #1 v1.5 and SHA-2")
        return self._verified(self._sign(bytes(data), mechanism), data, padding, algorithm)


def token_key(public: keys.PublicKey, sign: Sign, where: Origin | None = None) -> keys.PrivateKey:
    """Return the private key in a token of a public key; arguments as for a key of either algorithm."""
    if isinstance(public, ec.EllipticCurvePublicKey):
        return TokenEcKey(public, sign, where)
    return TokenRsaKey(public, sign, where)


def mismatch(where: Origin | None) -> KeymintError:
    """Return the error on a token that has another key than the one whose public key is known."""
    help_ = "name the certificate's key, or see 'keymint install --new-authority' for a new one"
    return KeymintError("the token has another key than the certificate", where=where, help=help_, code=MISMATCH)
