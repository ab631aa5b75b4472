# SPDX-License-Identifier: Apache-2.0
"""Signed documents: S/MIME ``multipart/signed`` (RFC 8551).

They are written in one form, which every reader that was measured takes. They are read in the forms that Keymint,
openssl and ``cryptography`` write, and only if every reader sees the same content.

Their frame is that of RFC 8551, 3.5.3, with the inner ``text/plain`` of OpenSSL.

Much software reads the frame with OpenSSL's ``SMIME_read_PKCS7`` (``crypto/asn1/asn_mime.c``), which is lenient: a line
that *begins* with ``--BOUNDARY`` is a separator, everything after ``--BOUNDARY--`` is ignored, a line longer than 1023
bytes is read in pieces that count as lines, headers may be repeated, folded, and in any case. Other MIME readers are
lenient in other ways. So this reader accepts a grammar in which all of them see the same content, and refuses others::

    MIME-Version: 1.0
    Content-Type: multipart/signed; protocol="TYPE"; micalg="sha-256"; boundary="BOUNDARY"

    This is an S/MIME signed message

    --BOUNDARY
    Content-Type: text/plain

    (the content)
    --BOUNDARY
    Content-Type: TYPE; name="smime.p7s"
    Content-Transfer-Encoding: base64
    Content-Disposition: attachment; filename="smime.p7s"

    (base64, 64 characters in a line)

    --BOUNDARY--

TYPE is ``application/x-pkcs7-signature``, or the same without ``x-``; the digest is SHA-256, SHA-384 or SHA-512.
BOUNDARY has 8 to 70 characters, none of which any reader treats specially (OpenSSL loses one of a single character).
``--BOUNDARY`` occurs nowhere else, not even within a line. Only blank lines follow. The frame, the text part and the
base64 each use one kind of line end, LF or CRLF: Keymint writes LF, ``cryptography`` CRLF, ``openssl smime
-sign -text`` LF around a text part in CRLF, and with ``-crlfeol`` CRLF around base64 in LF.
"""

from __future__ import annotations

import base64
import functools
import hashlib
import re
from binascii import a2b_base64
from collections.abc import Iterable, Sequence
from datetime import datetime
from typing import NoReturn

from cryptography import x509

from comarmor.text import lazy_regex
from comarmor.values import Data, field
from keymint import api
from keymint.errors import KeymintError, Origin
from keymint.pki import certificates, cms, der, examine, keys

UNREAD = "smime-form"
"""Error code for a file in a form that this reader refuses: how other software reads it is unknown."""

_MOST_LINES = 500_000
"""The most lines of a document, each of which takes more memory than its text."""
_BOUNDARY = 32
_DOCUMENT = b"""\
MIME-Version: 1.0
Content-Type: multipart/signed; protocol="application/x-pkcs7-signature"; micalg="sha-256"; boundary="----%(boundary)b"

This is an S/MIME signed message

------%(boundary)b
Content-Type: text/plain

%(content)b
------%(boundary)b
Content-Type: application/x-pkcs7-signature; name="smime.p7s"
Content-Transfer-Encoding: base64
Content-Disposition: attachment; filename="smime.p7s"

%(signature)b
------%(boundary)b--

"""

_MULTIPART = lazy_regex(
    rb'Content-Type: multipart/signed; protocol="(application/(?:x-)?pkcs7-signature)"; micalg="([a-z0-9,-]+)"; '
    rb'boundary="([0-9A-Za-z_+./:=?-]{8,70})"'
)
_HEAD = (
    b'MIME-Version: 1.0\nContent-Type: multipart/signed; protocol="application/x-pkcs7-signature"; micalg="sha-256"; '
    b'boundary="----%b"\n\nThis is an S/MIME signed message\n\n------%b\nContent-Type: text/plain\n\n'
)
"""What is before the content in a document of Keymint, and in most of openssl."""
_BEFORE_DIGITS, _DIGITS = _HEAD.index(b"%b"), frozenset(b"0123456789ABCDEF")
_BEFORE_SIGNATURE = b"""
Content-Type: application/x-pkcs7-signature; name="smime.p7s"
Content-Transfer-Encoding: base64
Content-Disposition: attachment; filename="smime.p7s"

"""
_DIGESTS = {b"sha-256": "sha256", b"sha-384": "sha384", b"sha-512": "sha512"}
_BEFORE_TEXT = 6
"""Lines of the frame before the text part."""
_BEFORE_CONTENT = 8
"""The same with the text part's header and the blank line after it."""
_SEPARATORS = 3
_SHOWN = 80
_MICALG_LINE = 2
_NAMELESS = Origin("document")


class SignedDocument(Data):
    """The parts of a signed file. Only :func:`read` returns one with a verified signature.

    Attributes:
        content: the signed document, with LF line ends. Readers pass it to their parsers with CRLF.
        signature: the detached signature, CMS in DER.
        lines_before: number of lines of the file before the content.
        digest: the digest algorithm that the frame names: ``sha256``, ``sha384`` or ``sha512``.
    """

    content: bytes
    signature: bytes = field(repr=False)
    lines_before: int
    digest: str


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
    return wrap(content, cms.sign(canonical_text(content), certificate, key))


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
    one reading (see above). The signer must be the authority itself, as readers that pass
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
    document = unwrap(signed, _NAMELESS)
    authority = certificates.load_first(ca_pem, with_lists=True)
    text = canonical_text(document.content)
    if cms.has_known_form(document.signature, document.digest, text, authority):
        examine.require_signer(authority, at)
        return document
    signature = _parsed(document, _NAMELESS)
    if signature.certificate != cms.identity_of(authority)[0]:
        message = "signed by another certificate than the authority's"
        raise KeymintError(message, help="'keymint install' signs it again", code="smime-signer")
    examine.require_signer(authority, at)
    if not cms.verify(signature, text, authority):
        message = "the signature is invalid: the document or its signature was altered"
        raise KeymintError(message, help="'keymint install' signs it again", code="smime-altered")
    cms.remember(document.signature, signature, text, authority)
    return document


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
    return unwrap(signed, where).content


def is_current(signed: bytes, content: bytes, certificate: x509.Certificate) -> bool:
    """Return whether a file is a valid signature of this content by this certificate: no need to sign again."""
    try:
        document = unwrap(signed)
        signature = _parsed(document, None)
    except KeymintError:
        return False
    return document.content == content and cms.verify(signature, canonical_text(content), certificate)


def _parsed(document: SignedDocument, where: Origin | None) -> cms.Signature:
    try:
        signature = cms.parse(document.signature)
    except ValueError as error:
        refuse(where, 0, f"its signature is not in the accepted form: {error}")
    if signature.digest != document.digest:
        refuse(where, _MICALG_LINE, f"micalg names {document.digest}, the signature has {signature.digest}")
    return signature


# -- the frame -------------------------------------------------------------------------------------------------------


def canonical_text(content: bytes) -> bytes:
    """Return the bytes to sign: the text part with its header, with CRLF line ends (RFC 8551, 3.1.1)."""
    return b"Content-Type: text/plain\r\n\r\n" + content.replace(b"\n", b"\r\n")


def wrap(content: bytes, signature: bytes) -> bytes:
    """Return the document: the content, and its detached signature (CMS in DER, SHA-256).

    The boundary is a digest of the content, so that the frame depends on the content only. (``cryptography`` writes the
    frame with the package ``email``, at ten times the cost of the signature.)
    """
    boundary = hashlib.sha256(content).hexdigest()[:_BOUNDARY].upper().encode()
    return _DOCUMENT % {b"boundary": boundary, b"content": content, b"signature": der.base64_lines(signature)}


def unwrap(document: bytes, where: Origin | None = None) -> SignedDocument:
    """Return the parts of a document, without verifying the signature.

    Args:
        document: the bytes of a signed file.
        where: the file, for messages.

    Raises:
        KeymintError: the document does not match the grammar above (code ``smime-form``); with the line and what was
            expected.
    """
    return _written(document) or _by_lines(document, where)


def _by_lines(document: bytes, where: Origin | None) -> SignedDocument:
    """Return the parts of a document in any form of the grammar; errors as :func:`unwrap`."""
    if document.count(b"\n") > _MOST_LINES:
        refuse(where, _MOST_LINES, f"it has more than {_MOST_LINES:,} lines")
    carriage_returns = b"\r" in document
    if b"\0" in document:
        refuse(where, document.count(b"\n", 0, document.index(b"\0")) + 1, "it has a NUL byte")
    if carriage_returns and (match := re.search(rb"\r(?!\n)", document)):
        line = document.count(b"\n", 0, match.start()) + 1
        refuse(where, line, "it has a carriage return without a line feed")
    lines = document.split(b"\n")
    texts = [line.removesuffix(b"\r") for line in lines] if carriage_returns else lines
    _require(texts, [(0, b"MIME-Version: 1.0")], where)
    multipart = _MULTIPART.fullmatch(texts[1]) if len(texts) > 1 else None
    if multipart is None:
        form = b'Content-Type: multipart/signed; protocol="..."; micalg="..."; boundary="..."'
        _refuse_line(texts, 1, form, where)
    protocol, digest, boundary = multipart.groups()
    if digest not in _DIGESTS:
        refuse(where, 2, f"its digest is {digest.decode()}, expected sha-256, sha-384 or sha-512")
    separator = b"--" + boundary
    _require(texts, enumerate((b"", b"This is an S/MIME signed message", b""), 2), where)
    second, last = _separators(document, texts, separator, where)
    if second <= _BEFORE_CONTENT:
        refuse(where, second + 1, "expected the text part with its header and a blank line")
    _require(texts, enumerate((separator, b"Content-Type: text/plain", b""), _BEFORE_TEXT - 1), where)
    headers = (
        b'Content-Type: %b; name="smime.p7s"' % protocol,
        b"Content-Transfer-Encoding: base64",
        b'Content-Disposition: attachment; filename="smime.p7s"',
        b"",
    )
    _require(texts, enumerate(headers, second + 1), where)
    _require(texts, [(last - 1, b""), *((line, b"") for line in range(last + 1, len(texts)))], where)
    base64_start = second + 1 + len(headers)
    # The line end before a separator belongs to the separator, and so to the frame.
    if carriage_returns:
        _require_line_ends(lines, range(_BEFORE_TEXT, second - 1), range(base64_start, last - 1), where)
    encoded = texts[base64_start : last - 1]
    try:
        signature = base64.b64decode(b"".join(encoded), validate=True)
    except ValueError:
        signature = b""
    if not signature or der.base64_lines(signature).splitlines() != encoded:
        refuse(where, base64_start + 1, f"expected the signature in base64, {der.BASE64_LINE} characters in a line")
    content = b"\n".join(texts[_BEFORE_CONTENT:second])
    return SignedDocument(content, signature, _BEFORE_CONTENT, _DIGESTS[digest])


@functools.lru_cache(maxsize=16)
def _written(document: bytes) -> SignedDocument | None:
    """Return the parts of a document in the form that Keymint writes; None for one to be judged line by line."""
    digits = document[_BEFORE_DIGITS : _BEFORE_DIGITS + _BOUNDARY]
    head = _HEAD % (digits, digits)
    if not (document.startswith(head) and _DIGITS.issuperset(digits) and len(document) <= _MOST_LINES):
        return None
    # Such a boundary cannot overlap itself, so that these are all that readers could take for separators.
    parts = document[len(head) :].split(b"------" + digits)
    if len(parts) != _SEPARATORS or b"\r" in document or b"\0" in document:
        return None
    text, encoded, end = parts
    try:
        signature = a2b_base64(encoded[len(_BEFORE_SIGNATURE) :])
    except ValueError:
        return None
    is_exact = encoded == b"%b%b\n" % (_BEFORE_SIGNATURE, der.base64_lines(signature)) and end.rstrip(b"\n") == b"--"
    if not (signature and is_exact and text.endswith(b"\n")):
        return None
    return SignedDocument(text[:-1], signature, _BEFORE_CONTENT, "sha256")


def refuse(where: Origin | None, line: int, problem: str) -> NoReturn:
    """Raise the error for a document that readers may read differently, or not at all.

    Args:
        where: the file.
        line: the line in the file, or 0.
        problem: what is wrong, and what was expected.
    """
    place = Origin(where.file, line) if where is not None and line else where
    message = f"is malformed or ambiguous S/MIME: {problem}"
    raise KeymintError(message, where=place, help="'keymint install' signs it again", code=UNREAD)


def _require(texts: Sequence[bytes], expected: Iterable[tuple[int, bytes]], where: Origin | None) -> None:
    """Refuse a document unless each numbered line (from 0, without its line end) has the expected text."""
    for line, text in expected:
        if line >= len(texts) or texts[line] != text:
            _refuse_line(texts, line, text, where)


def _refuse_line(texts: Sequence[bytes], line: int, expected: bytes, where: Origin | None) -> NoReturn:
    actual = _shown(texts[line]) if line < len(texts) else "the end of the file"
    refuse(where, line + 1, f"expected {_shown(expected)}, found {actual}")


def _separators(document: bytes, texts: Sequence[bytes], separator: bytes, where: Origin | None) -> tuple[int, int]:
    """Return the lines of the last two of the three separators, whose text must occur nowhere else."""
    places: list[int] = []
    position = -1
    while (position := document.find(separator, position + 1)) >= 0:
        places.append(document.count(b"\n", 0, position))
    _require(texts, zip(places, (separator, separator, separator + b"--"), strict=False), where)
    if len(places) != _SEPARATORS:
        line = places[_SEPARATORS] if len(places) > _SEPARATORS else len(texts) - 1
        refuse(where, line + 1, f"expected {_shown(separator)} in three places, the file has {len(places)}")
    return places[1], places[2]


def _require_line_ends(lines: Sequence[bytes], text_part: range, encoded: range, where: Origin | None) -> None:
    """Refuse a document unless the frame, the text part and the base64 each have one kind of line end."""
    for line, text in enumerate(lines[:-1]):
        like = next((part.start for part in (text_part, encoded) if line in part), 0)
        crlf = lines[like].endswith(b"\r")
        if text.endswith(b"\r") != crlf:
            actual, expected = ("LF", "CRLF") if crlf else ("CRLF", "LF")
            refuse(where, line + 1, f"the line ends with {actual}, expected {expected} as in line {like + 1}")


def _shown(line: bytes) -> str:
    """Return a line for messages, with everything but printable ASCII escaped."""
    if not line:
        return "a blank line"
    text = repr(line[:_SHOWN])[1:]
    return text if len(line) <= _SHOWN else f"{text}..."
