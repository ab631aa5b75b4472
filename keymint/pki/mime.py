"""The frame of a signed document: ``multipart/signed`` (RFC 8551, 3.5.3) in exactly one form.

It is the form of ``openssl smime -sign -text``: DDS vendors read it with OpenSSL's ``SMIME_read_PKCS7`` and demand
the inner ``Content-Type: text/plain`` (``PKCS7_TEXT``). Lines end in LF, which OpenSSL turns into the CRLF that is
signed. The boundary is a digest of the content: the frame is a function of what it holds, and whoever reads it can
write it again and compare, so that no byte of it can change unseen. (``cryptography`` writes the frame with the
package ``email``, at ten times the cost of the signature.)
"""

from __future__ import annotations

import base64
import hashlib

from keymint.errors import KeymintError, Origin

_LINE = 64
_BOUNDARY = 32
_HEAD = (
    b'MIME-Version: 1.0\nContent-Type: multipart/signed; protocol="application/x-pkcs7-signature"; '
    b'micalg="sha-256"; boundary="----'
)
_TEXT = b'"\n\nThis is an S/MIME signed message\n\n------%b\nContent-Type: text/plain\n\n'
_SIGNATURE = (
    b"\n------%b\n"
    b'Content-Type: application/x-pkcs7-signature; name="smime.p7s"\n'
    b"Content-Transfer-Encoding: base64\n"
    b'Content-Disposition: attachment; filename="smime.p7s"\n\n'
)
_TAIL = b"\n------%b--\n\n"


def canonical_text(content: bytes) -> bytes:
    """Return what is signed: the text part with its header, in CRLF line ends (RFC 8551, 3.1.1)."""
    return b"Content-Type: text/plain\r\n\r\n" + content.replace(b"\n", b"\r\n")


def wrap(content: bytes, signature: bytes) -> bytes:
    """Return the document: the content, and its detached signature (CMS in DER)."""
    boundary = hashlib.sha256(content).hexdigest()[:_BOUNDARY].upper().encode()
    text = base64.b64encode(signature)
    lines = b"".join(text[start : start + _LINE] + b"\n" for start in range(0, len(text), _LINE))
    return b"".join(
        (_HEAD, boundary, _TEXT % boundary, content, _SIGNATURE % boundary, lines, _TAIL % boundary),
    )


def unwrap(document: bytes, where: Origin | None = None) -> tuple[bytes, bytes]:
    """Return the content and the signature (CMS in DER) of a document.

    Args:
        document: the bytes of a signed file.
        where: the file, for messages.

    Raises:
        KeymintError: the document is not byte for byte what :func:`wrap` writes.
    """
    boundary = document[len(_HEAD) : len(_HEAD) + _BOUNDARY]
    head = _HEAD + boundary + _TEXT % boundary
    middle, tail = _SIGNATURE % boundary, _TAIL % boundary
    found = document.rfind(middle)
    if document.startswith(head) and document.endswith(tail) and found >= len(head):
        content = document[len(head) : found]
        try:
            signature = base64.b64decode(document[found + len(middle) : -len(tail)])
        except ValueError:
            signature = b""
        if wrap(content, signature) == document:
            return content, signature
    raise KeymintError(
        "not a signed document in the form that Keymint writes, or one that was altered",
        where=where,
        help="sign it again with keymint install",
        code="smime-altered",
    )
