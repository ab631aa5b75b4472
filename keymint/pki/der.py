# SPDX-License-Identifier: Apache-2.0
"""The part of the Distinguished Encoding Rules (ITU-T X.690) that CMS and raw extensions need.

``cryptography`` signs CMS but does not verify it, and its own ASN.1 interface is declared unstable. The reader is
strict: it refuses every encoding but the canonical one, so that an altered byte is always detected.
"""

from __future__ import annotations

import hashlib
import struct
from binascii import b2a_base64

from cryptography import x509
from cryptography.hazmat.primitives import hashes

BOOLEAN = 0x01
INTEGER = 0x02
BIT_STRING = 0x03
OCTET_STRING = 0x04
NULL = 0x05
UTF8_STRING = 0x0C
PRINTABLE_STRING = 0x13
IA5_STRING = 0x16
UTC_TIME = 0x17
GENERALIZED_TIME = 0x18
SEQUENCE = 0x30
SET = 0x31
CONTEXT_0 = 0xA0
CONTEXT_1 = 0xA1
CONTEXT_3 = 0xA3
BASE64_LINE = 64
"""Characters of base64 on a line of PEM (RFC 7468, section 2) and of Keymint's S/MIME."""

_LONG_TAG = 0x1F
_LONG_LENGTH = 0x80
_MAX_LENGTH_BYTES = 4


def tlv(tag: int, *parts: bytes) -> bytes:
    """Return an element: tag, length, and the concatenated parts as its content."""
    content = b"".join(parts)
    size = len(content)
    if size < _LONG_LENGTH:
        return bytes((tag, size)) + content
    octets = size.to_bytes((size.bit_length() + 7) // 8, "big")
    return bytes((tag, _LONG_LENGTH | len(octets))) + octets + content


def base64_lines(content: bytes) -> bytes:
    """Return the base64 of a content in lines of :data:`BASE64_LINE` characters, each with a line feed."""
    text = b2a_base64(content, newline=False)
    whole, rest = divmod(len(text), BASE64_LINE)
    lines = struct.unpack(f"{f'{BASE64_LINE}s' * whole}{rest}s", text)  # the last one is empty if there is no rest
    return b"\n".join((*lines, b"") if rest else lines)


def pem(label: bytes, content: bytes) -> bytes:
    """Return a content as PEM (RFC 7468), such as that of a ``CERTIFICATE``."""
    return b"-----BEGIN %b-----\n%b-----END %b-----\n" % (label, base64_lines(content), label)


def der_of(signed: x509.Certificate | x509.CertificateRevocationList) -> bytes:
    """Return a certificate or a revocation list in DER.

    It is put together from its parts, and the library's digest of it tells whether each byte is right. What the library
    has for it loads the readers of all keys, see :mod:`~keymint.pki.key_encodings`.
    """
    body = signed.tbs_certificate_bytes if isinstance(signed, x509.Certificate) else signed.tbs_certlist_bytes
    algorithm = next(each for each in elements(single(body, SEQUENCE)) if each[0] == SEQUENCE)
    made = tlv(SEQUENCE, body, algorithm, tlv(BIT_STRING, b"\0", signed.signature))
    if hashlib.sha256(made).digest() == signed.fingerprint(hashes.SHA256()):
        return made
    from cryptography.hazmat.primitives.serialization import Encoding  # noqa: PLC0415 - few have an odd encoding

    return signed.public_bytes(Encoding.DER)


def oid(dotted: str) -> bytes:
    """Return an OBJECT IDENTIFIER element for a dotted identifier such as ``1.2.840.113549.1.7.2``."""
    # The library encodes one only as a part of something: of a SEQUENCE of them, here.
    return single(x509.ExtendedKeyUsage([x509.ObjectIdentifier(dotted)]).public_bytes(), SEQUENCE)


def elements(data: bytes) -> list[bytes]:
    """Return each element of the data with its header.

    Raises:
        ValueError: not DER: a truncated element, a length in more bytes than needed, a tag above 30.
    """
    found: list[bytes] = []
    position = 0
    while position < len(data):
        _, _, end = _header(data, position)
        found.append(data[position:end])
        position = end
    return found


def first_element(data: bytes) -> bytes:
    """Return the first element of the data with its header, whatever follows it; errors as :func:`elements`."""
    return data[: _header(data, 0)[2]]


def single(data: bytes, tag: int) -> bytes:
    """Return the content of data that must be one element with this tag.

    Raises:
        ValueError: not DER, another tag, or more than one element.
    """
    found, start, end = _header(data, 0) if data else (None, 0, 0)
    if found != tag or end != len(data):
        elements(data)  # raises an error for data that is not DER
        raise ValueError("not one element of the expected tag")
    return data[start:end]


def _header(data: bytes, position: int) -> tuple[int, int, int]:
    """Return the tag at a position, and where its content begins and ends."""
    start = position + 2
    if start > len(data) or data[position] & _LONG_TAG == _LONG_TAG:
        raise ValueError("no tag and length")
    size = data[position + 1]
    if size >= _LONG_LENGTH:
        count = size - _LONG_LENGTH
        octets = data[start : start + count]
        size = int.from_bytes(octets, "big")
        if not 1 <= count <= _MAX_LENGTH_BYTES or len(octets) != count or octets[0] == 0 or size < _LONG_LENGTH:
            raise ValueError("a length that is not in its shortest form")
        start += count
    if start + size > len(data):
        raise ValueError("a truncated element")
    return data[position], start, start + size
