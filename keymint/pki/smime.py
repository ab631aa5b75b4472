"""Signed documents: S/MIME as DDS Security demands of permissions and governance (DDS Security 1.1, 9.4.1.1).

Written in one form, that Cyclone DDS and Fast DDS read, and read back strictly: any altered byte is an error.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, field
from datetime import datetime

from cryptography import x509
from cryptography.hazmat.primitives import serialization

from keymint import api
from keymint.errors import KeymintError, Origin
from keymint.pki import certificates, cms, keys, mime


@dataclass(frozen=True, slots=True)
class Signer:
    """An authority, loaded: its certificate and its private key."""

    certificate: x509.Certificate
    key: keys.PrivateKey = field(repr=False)


@functools.lru_cache(maxsize=16)
def load_signer(signer: api.Signer) -> Signer:
    """Return an authority, loaded once for all documents of a run: reading a key costs more than signing.

    Raises:
        KeymintError: the certificate or the key cannot be read, or the two do not belong together.
    """
    where = Origin(f"authority {signer.name}")
    certificate = certificates.load(signer.certificate, where)
    key = keys.from_pem(signer.key, signer.password, where)
    if not keys.matches(key, certificate):
        raise KeymintError(
            "the private key does not belong to the certificate",
            where=where,
            help="restore the file that was replaced, or mint both anew with --renew",
            code="key-mismatch",
        )
    return Signer(certificate, key)


def sign(content: bytes, certificate: x509.Certificate, key: keys.PrivateKey, where: Origin | None = None) -> bytes:
    """Return a document, signed: ``multipart/signed`` with the text header, detached, SHA-256.

    Args:
        content: the document: text with LF line ends.
        certificate: the signer's certificate, which is embedded.
        key: its private key.
        where: the document, for messages.

    Raises:
        KeymintError: the content has a byte that does not survive S/MIME or a vendor's parser (CR, NUL).
    """
    for byte, shown, help_ in (
        (b"\r", "a carriage return", "save it with Unix line ends (LF)"),
        (b"\0", "a NUL byte", "remove it"),
    ):
        if byte in content:
            line = content[: content.index(byte)].count(b"\n") + 1
            place = Origin(where.file, line) if where else None
            raise KeymintError(
                f"a document with {shown} cannot be signed", where=place, help=help_, code="smime-content"
            )
    return mime.wrap(content, cms.sign(mime.canonical_text(content), certificate, key))


def verify(signed: bytes, ca_pem: bytes, *, at: datetime | None = None, where: Origin | None = None) -> bytes:
    """Return the content of a signed document, verified.

    The signer must be the permissions authority itself, as the vendors demand that pass ``PKCS7_NOINTERN``.

    Args:
        signed: the bytes of the signed file.
        ca_pem: certificate of the permissions authority, PEM; of a bundle the first, as for the vendors.
        at: also check that the authority's certificate is valid at this time (aware).
        where: the file, for messages.

    Raises:
        KeymintError: an altered byte, another signer, or an authority that may not sign; says which.
    """
    content, raw = mime.unwrap(signed, where)
    authority = certificates.load_bundle(ca_pem, where)[0]
    signature = _parsed(raw, where)
    if signature.certificate != authority.public_bytes(serialization.Encoding.DER):
        raise KeymintError(
            "signed by another certificate than the permissions authority's",
            where=where,
            help="sign it again with keymint install",
            code="smime-signer",
        )
    if problem := certificates.can_sign_documents(authority, where):
        raise KeymintError.of([problem])
    if at is not None and not authority.not_valid_before_utc <= at <= authority.not_valid_after_utc:
        raise KeymintError(
            "the permissions authority's certificate is valid "
            f"from {authority.not_valid_before_utc:%Y-%m-%d} "
            f"to {authority.not_valid_after_utc:%Y-%m-%d}, not at {at:%Y-%m-%d}",
            where=where,
            help="renew the authority with --renew",
            code="smime-authority-expired",
        )
    if not cms.verify(signature, mime.canonical_text(content), authority):
        raise _altered(where)
    return content


def signed_content(signed: bytes, where: Origin | None = None) -> bytes:
    """Return the content of a signed document without verifying the signature.

    Raises:
        KeymintError: not a document in the form that :func:`sign` writes.
    """
    return mime.unwrap(signed, where)[0]


def signer_is(signed: bytes, certificate: x509.Certificate) -> bool:
    """Tell whether a signed document names a certificate as its signer; the signature is not verified."""
    try:
        signature = cms.parse(mime.unwrap(signed)[1])
    except (KeymintError, ValueError):
        return False
    return signature.certificate == certificate.public_bytes(serialization.Encoding.DER)


def is_current(signed: bytes, content: bytes, certificate: x509.Certificate) -> bool:
    """Tell whether signing again is needless: this content is signed, by this certificate, and soundly."""
    try:
        found, raw = mime.unwrap(signed)
        signature = cms.parse(raw)
    except (KeymintError, ValueError):
        return False
    return found == content and cms.verify(signature, mime.canonical_text(content), certificate)


def _parsed(raw: bytes, where: Origin | None) -> cms.Signature:
    try:
        return cms.parse(raw)
    except ValueError:
        raise _altered(where) from None


def _altered(where: Origin | None) -> KeymintError:
    return KeymintError(
        "the signature does not hold: the document or its signature was altered",
        where=where,
        help="sign it again with keymint install",
        code="smime-altered",
    )
