# SPDX-License-Identifier: Apache-2.0
"""Public keys of subjects whose private keys are elsewhere, as SubjectPublicKeyInfo in PEM (RFC 7468, 13)."""

from __future__ import annotations

from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives import serialization

from comarmor.errors import Origin
from keymint.errors import KeymintError
from keymint.pki.keys import PublicKey


def from_pem(pem: bytes, where: Origin | None = None) -> PublicKey:
    """Return the public key of a PEM text.

    Args:
        pem: the text, with one public key.
        where: its place, for messages.

    Raises:
        KeymintError: not a public key, or one that is neither EC nor RSA.
    """
    try:
        key = serialization.load_pem_public_key(pem)
    except (ValueError, TypeError, UnsupportedAlgorithm):
        key = None
    if not isinstance(key, PublicKey):
        raise KeymintError(
            "not an EC or RSA public key in PEM (SubjectPublicKeyInfo), or a damaged one",
            where=where,
            help="restore it from version control, or sign a new request of the machine that has the private key",
            code="public-key-invalid",
        )
    return key


def to_pem(key: PublicKey) -> bytes:
    """Return a public key as PEM; equal keys give equal bytes."""
    return key.public_bytes(serialization.Encoding.PEM, serialization.PublicFormat.SubjectPublicKeyInfo)
