# SPDX-License-Identifier: Apache-2.0
"""Signed documents: S/MIME ``multipart/signed`` (RFC 8551).

They are written in one form, which every reader that was measured takes. They are read in the forms that Keymint,
openssl and ``cryptography`` write, and only if every reader sees the same content.
"""

from __future__ import annotations

import functools
from datetime import datetime

from cryptography import x509
from cryptography.hazmat.primitives import serialization

from comarmor.errors import Origin
from keymint import api
from keymint.errors import KeymintError
from keymint.pki import certificates, cms, examine, keys, mime
from keymint.pki.mime import SignedDocument

_MICALG_LINE = 2
_NAMELESS = Origin("document")


@functools.lru_cache(maxsize=16)
def load_signer(signer: api.SigningAuthority) -> certificates.Issuer:
    """Return an authority, loaded once for all documents of a run: reading a key costs more than signing.

    Raises:
        KeymintError: the certificate or the key cannot be read, or they do not match.
    """
    where = Origin(f"authority {signer.name}")
    certificate = certificates.load(signer.certificate, where)
    key = signer.token_key or keys.from_pem(signer.key, signer.password, where)
    return examine.issuer_with(certificate, key, where)


def sign(content: bytes, certificate: x509.Certificate, key: keys.PrivateKey, where: Origin | None = None) -> bytes:
    """Return a signed document: ``multipart/signed`` with the text header, detached, SHA-256.

    Args:
        content: the document: text with LF line ends.
        certificate: the signer's certificate, to embed.
        key: the signer's private key.
        where: the document, for messages.

    Raises:
        KeymintError: the content has a byte that does not survive S/MIME or a vendor's parser (CR, NUL).
    """
    require_signable(content, where)
    return mime.wrap(content, cms.sign(mime.canonical_text(content), certificate, key))


def require_signable(content: bytes, where: Origin | None) -> None:
    """Require that a document survives S/MIME and the parsers of vendors.

    Args:
        content: the document.
        where: its place, for messages.

    Raises:
        KeymintError: the content has a byte that does not (CR, NUL).
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


def read(signed: bytes, ca_pem: bytes, *, at: datetime | None = None, where: Origin | None = None) -> SignedDocument:
    """Verify a signed document and return it: the only reader of signed files, used by every claim.

    It accepts the forms that Keymint, ``openssl smime -sign -text`` and ``cryptography`` write, if they have exactly
    one reading (:mod:`keymint.pki.mime`). The signer must be the authority itself, as readers that pass
    ``PKCS7_NOINTERN`` require; a certificate that the authority issued is not enough (CVE-2023-24010).

    Args:
        signed: the bytes of the signed file.
        ca_pem: certificate of the authority, PEM; the first one of a bundle.
        at: also check that the authority's certificate is valid at this time (aware).
        where: the file, for messages.

    Raises:
        KeymintError: ``smime-form``: other software may read the file differently. ``smime-altered``: the signature is
            invalid. ``smime-signer``: another signer. ``authority-cannot-sign``,
            ``smime-authority-expired`` and ``certificate-invalid``: the authority may not sign, or cannot be read.
    """
    try:
        return _read(signed, ca_pem, at)
    except KeymintError as error:
        found = error.diagnostics[0].where
        raise error.at(Origin(where.file, found.line) if where and found and found.line else where) from None


# Several claims rest on one file, and many enclaves have a file in common.
@functools.lru_cache(maxsize=16)
def _read(signed: bytes, ca_pem: bytes, at: datetime | None) -> SignedDocument:
    """Verify a signed document; places of errors have a line only."""
    document = mime.unwrap(signed, _NAMELESS)
    signature = _parsed(document, _NAMELESS)
    authority = _authority(ca_pem)
    if signature.certificate != authority.public_bytes(serialization.Encoding.DER):
        raise KeymintError(
            "signed by another certificate than the authority's",
            help="'keymint install' signs it again",
            code="smime-signer",
        )
    examine.require_signer(authority, at)
    if not cms.verify(signature, mime.canonical_text(document.content), authority):
        raise KeymintError(
            "the signature is invalid: the document or its signature was altered",
            help="'keymint install' signs it again",
            code="smime-altered",
        )
    return document


@functools.lru_cache(maxsize=16)
def _authority(ca_pem: bytes) -> x509.Certificate:
    return certificates.load_first(ca_pem, with_lists=True)


def verify(signed: bytes, ca_pem: bytes, *, at: datetime | None = None, where: Origin | None = None) -> bytes:
    """Verify a signed document and return its content.

    Raises:
        KeymintError: as :func:`read`.
    """
    return read(signed, ca_pem, at=at, where=where).content


def signed_content(signed: bytes, where: Origin | None = None) -> bytes:
    """Return the content of a signed document without verifying the signature.

    Raises:
        KeymintError: the file does not have exactly one reading (code ``smime-form``).
    """
    return unverified_document(signed, where).content


def unverified_document(signed: bytes, where: Origin | None = None) -> SignedDocument:
    """Return a signed document without verifying the signature; errors as :func:`signed_content`."""
    return mime.unwrap(signed, where)


def is_current(signed: bytes, content: bytes, certificate: x509.Certificate) -> bool:
    """Return whether a file is a valid signature of this content by this certificate: no need to sign again."""
    try:
        document = mime.unwrap(signed)
        signature = _parsed(document, None)
    except KeymintError:
        return False
    return document.content == content and cms.verify(signature, mime.canonical_text(content), certificate)


def _parsed(document: SignedDocument, where: Origin | None) -> cms.Signature:
    try:
        signature = cms.parse(document.signature)
    except ValueError as error:
        mime.refuse(where, 0, f"its signature is not in the accepted form: {error}")
    if signature.digest != document.digest:
        mime.refuse(where, _MICALG_LINE, f"micalg names {document.digest}, the signature has {signature.digest}")
    return signature
