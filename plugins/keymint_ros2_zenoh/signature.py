# SPDX-License-Identifier: Apache-2.0
"""The detached signature over the router's configuration: CMS in DER (RFC 5652), for Keymint and ``openssl cms``."""

from __future__ import annotations

from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding

from keymint.pki import cms
from keymint.pki.certificates import Issuer


def sign(content: bytes, signer: Issuer) -> bytes:
    """Return a detached signature over these bytes, with SHA-256."""
    return cms.sign(content, signer.certificate, signer.key)


def problem(content: bytes, signature: bytes, authority: x509.Certificate) -> str:
    """Return why a signature is not one by an authority over a router's configuration; empty if it is.

    Args:
        content: the router's configuration.
        signature: the detached signature.
        authority: certificate of the authority that must have made it.
    """
    try:
        parsed = cms.parse(signature)
    except ValueError as error:
        return f"is not a detached signature: {error}"
    if cms.verify(parsed, content, authority):
        return ""
    if parsed.certificate != authority.public_bytes(Encoding.DER):  # compared unread: it may be damaged
        return "is by another certificate than that of the authority that signs the rights"
    return "is not over the configuration beside it: one of them was altered, or is older than the other"
