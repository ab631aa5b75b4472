"""The content of a signed document as vendors read it: also one that another tool signed.

``keymint check`` accepts only what Keymint writes, byte for byte. What is proven is about what vendors accept, and they
take the S/MIME of ``openssl smime -sign -text`` as well.
"""

from __future__ import annotations

import base64
import binascii
import re

from keymint.errors import KeymintError, Origin
from keymint.pki import certificates, cms, mime, smime

_BOUNDARY = re.compile(rb'boundary="([^"\r\n]{1,100})"', re.IGNORECASE)
_BLANK = re.compile(rb"\r?\n\r?\n")
_HEADER = b"content-type: text/plain"


def content(signed: bytes, authority: bytes, where: Origin) -> bytes:
    """Return the content of a signed document, with LF line ends, its signature verified.

    Args:
        signed: the bytes of the signed file.
        authority: certificate of the permissions authority, PEM.
        where: the file, for messages.

    Raises:
        KeymintError: the signature does not hold, or the form of the file is not known.
    """
    try:
        return smime.verify(signed, authority, where=where)
    except KeymintError:
        found = _foreign(signed, authority, where)
        if found is None:
            raise
        return found


def lines_before(content: bytes, signed: bytes) -> int:
    """Return how many lines of a signed file come before its content."""
    text = signed.replace(b"\r\n", b"\n")
    return text.count(b"\n", 0, max(text.find(content), 0))


def _foreign(signed: bytes, authority: bytes, where: Origin) -> bytes | None:
    """Return the verified content of a document that another tool signed, or None."""
    boundary = _BOUNDARY.search(signed[:1000])
    if boundary is None:
        return None
    parts = re.split(rb"\r?\n--" + re.escape(boundary[1]) + rb"(?:--)?[ \t]*\r?\n", signed)
    if len(parts) < 3:  # noqa: PLR2004 - a preamble, the text, the signature
        return None
    text = parts[1].replace(b"\r\n", b"\n")
    header, _, body = text.partition(b"\n\n")
    blank = _BLANK.search(parts[2])
    if header.strip().lower() != _HEADER or blank is None:
        return None
    try:
        signature = cms.parse(base64.b64decode(parts[2][blank.end() :]))
    except (ValueError, binascii.Error):
        return None
    own = certificates.load(authority, where)
    return body if cms.verify(signature, mime.canonical_text(body), own) else None
