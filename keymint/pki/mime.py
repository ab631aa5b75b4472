"""The frame of a signed document: ``multipart/signed`` (RFC 8551, 3.5.3) with the inner ``text/plain`` of OpenSSL.

DDS vendors read the frame with OpenSSL's ``SMIME_read_PKCS7`` (``crypto/asn1/asn_mime.c``), which is lenient: a line
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
base64 each use one kind of line end, LF or CRLF: Keymint writes LF, SROS2 (``cryptography``) CRLF, ``openssl smime
-sign -text`` LF around a text part in CRLF, and with ``-crlfeol`` CRLF around base64 in LF.
"""

from __future__ import annotations

import base64
import hashlib
import re
from dataclasses import dataclass, field
from typing import NoReturn

from comarmor.errors import Origin
from keymint.errors import KeymintError

UNREAD = "smime-form"
"""Error code for a file in a form that this reader refuses: how vendors read it is unknown."""

_LINE = 64
_BOUNDARY = 32
_TYPE = b"application/x-pkcs7-signature"
_HEAD = b'MIME-Version: 1.0\nContent-Type: multipart/signed; protocol="%b"; micalg="sha-256"; boundary="----' % _TYPE
_TEXT = b'"\n\nThis is an S/MIME signed message\n\n------%b\nContent-Type: text/plain\n\n'
_SIGNATURE = (
    b'\n------%%b\nContent-Type: %b; name="smime.p7s"\n'
    b"Content-Transfer-Encoding: base64\n"
    b'Content-Disposition: attachment; filename="smime.p7s"\n\n' % _TYPE
)
_TAIL = b"\n------%b--\n\n"

_MULTIPART = re.compile(
    rb'Content-Type: multipart/signed; protocol="(application/(?:x-)?pkcs7-signature)"; micalg="([a-z0-9,-]+)"; '
    rb'boundary="([0-9A-Za-z_+./:=?-]{8,70})"'
)
_DIGESTS = {b"sha-256": "sha256", b"sha-384": "sha384", b"sha-512": "sha512"}
_BEFORE_TEXT = 6
"""Lines of the frame before the text part."""
_BEFORE_CONTENT = 8
"""The same with the text part's header and the blank line after it."""
_BARE_CR = re.compile(rb"\r(?!\n)")
_SHOWN = 80


@dataclass(frozen=True, slots=True)
class SignedDocument:
    """The parts of a signed file. Only :func:`keymint.pki.smime.read` returns one with a verified signature.

    Attributes:
        content: the signed document, with LF line ends. Vendors pass it to their parsers with CRLF.
        signature: the detached signature, CMS in DER.
        lines_before: number of lines of the file before the content.
        digest: the digest algorithm that the frame names: ``sha256``, ``sha384`` or ``sha512``.
    """

    content: bytes
    signature: bytes = field(repr=False)
    lines_before: int
    digest: str


def canonical_text(content: bytes) -> bytes:
    """Return the bytes to sign: the text part with its header, with CRLF line ends (RFC 8551, 3.1.1)."""
    return b"Content-Type: text/plain\r\n\r\n" + content.replace(b"\n", b"\r\n")


def wrap(content: bytes, signature: bytes) -> bytes:
    """Return the document: the content, and its detached signature (CMS in DER, SHA-256).

    The boundary is a digest of the content, so that the frame depends on the content only. (``cryptography`` writes the
    frame with the package ``email``, at ten times the cost of the signature.)
    """
    boundary = hashlib.sha256(content).hexdigest()[:_BOUNDARY].upper().encode()
    text = base64.b64encode(signature)
    lines = b"".join(text[start : start + _LINE] + b"\n" for start in range(0, len(text), _LINE))
    return b"".join(
        (_HEAD, boundary, _TEXT % boundary, content, _SIGNATURE % boundary, lines, _TAIL % boundary),
    )


def unwrap(document: bytes, where: Origin | None = None) -> SignedDocument:
    """Return the parts of a document, without verifying the signature.

    Args:
        document: the bytes of a signed file.
        where: the file, for messages.

    Raises:
        KeymintError: the document does not match the grammar above (code ``smime-form``); with the line and what was
            expected.
    """
    return _MimeParser(document, where).document()


def refuse(where: Origin | None, line: int, problem: str) -> NoReturn:
    """Raise the error for a document that readers may read differently, or not at all.

    Args:
        where: the file.
        line: the line in the file, or 0.
        problem: what is wrong, and what was expected.
    """
    place = Origin(where.file, line) if where is not None and line else where
    raise KeymintError(
        f"is not a signed document with exactly one reading: {problem}",
        where=place,
        help="sign it again with keymint install",
        code=UNREAD,
    )


class _MimeParser:
    """Parses one document, line by line. Lines are counted from 0 here, and from 1 in messages."""

    def __init__(self, document: bytes, where: Origin | None) -> None:
        self._where = where
        for pattern, name in ((rb"\x00", "a NUL byte"), (_BARE_CR, "a carriage return without a line feed")):
            if match := re.search(pattern, document):
                self._refuse(document.count(b"\n", 0, match.start()), f"it has {name}")
        self._document = document
        self._lines = document.split(b"\n")
        self._returns = self._lines[0].endswith(b"\r")

    def document(self) -> SignedDocument:
        self._expect(0, b"MIME-Version: 1.0")
        protocol, digest, separator = self._multipart()
        self._expect(2, b"")
        self._expect(3, b"This is an S/MIME signed message")
        self._expect(4, b"")
        first, second, last = self._separators(separator)
        if first != _BEFORE_TEXT - 1:
            self._refuse(_BEFORE_TEXT - 1, f"expected the first {_shown(separator)}")
        content = self._content(second)
        signature = self._signature(protocol, second, last)
        for line in range(last + 1, len(self._lines)):
            if line < len(self._lines) - 1 or self._lines[line]:
                self._expect(line, b"")
        return SignedDocument(content, signature, _BEFORE_CONTENT, digest)

    def _multipart(self) -> tuple[bytes, str, bytes]:
        """Return the signature's type, the digest, and the separator line."""
        match = _MULTIPART.fullmatch(self._frame(1)) if len(self._lines) > 1 else None
        if match is None:
            self._unexpected(1, b'Content-Type: multipart/signed; protocol="..."; micalg="..."; boundary="..."')
        digest = _DIGESTS.get(match[2])
        if digest is None:
            self._refuse(1, f"its digest is {match[2].decode()}, expected sha-256, sha-384 or sha-512")
        return match[1], digest, b"--" + match[3]

    def _separators(self, separator: bytes) -> tuple[int, int, int]:
        """Return the lines of the three separators; their text must occur nowhere else."""
        overlapping = re.compile(b"(?=" + re.escape(separator) + b")")
        lines = [self._document.count(b"\n", 0, each.start()) for each in overlapping.finditer(self._document)]
        expected = (separator, separator, separator + b"--")
        for line, text in zip(lines, expected, strict=False):
            self._expect(line, text)
        if len(lines) != len(expected):
            last = lines[len(expected)] if len(lines) > len(expected) else len(self._lines) - 1
            self._refuse(last, f"expected {_shown(separator)} in three places, the file has {len(lines)}")
        return lines[0], lines[1], lines[2]

    def _content(self, second: int) -> bytes:
        """Return the content. The line end before the second separator belongs to the separator."""
        if second < _BEFORE_CONTENT + 1:
            self._refuse(second, "expected the text part with its header and a blank line")
        lines = [*self._section(_BEFORE_TEXT, second - 1), self._frame(second - 1)]
        for number, wanted in enumerate((b"Content-Type: text/plain", b"")):
            if lines[number] != wanted:
                self._unexpected(_BEFORE_TEXT + number, wanted)
        return b"\n".join(lines[_BEFORE_CONTENT - _BEFORE_TEXT :])

    def _signature(self, protocol: bytes, second: int, last: int) -> bytes:
        headers = (
            b'Content-Type: %b; name="smime.p7s"' % protocol,
            b"Content-Transfer-Encoding: base64",
            b'Content-Disposition: attachment; filename="smime.p7s"',
            b"",
        )
        for number, wanted in enumerate(headers, second + 1):
            self._expect(number, wanted)
        start = second + 1 + len(headers)
        self._expect(last - 1, b"")
        lines = self._section(start, last - 1)
        for number, text in enumerate(lines):
            if len(text) != _LINE and (number < len(lines) - 1 or not 1 <= len(text) < _LINE):
                self._refuse(start + number, f"expected {_LINE} characters of base64, fewer only in the last line")
        joined = b"".join(lines)
        try:
            signature = base64.b64decode(joined, validate=True)
        except ValueError:
            signature = b""
        if not joined or base64.b64encode(signature) != joined:
            self._refuse(start, "expected the signature in base64")
        return signature

    def _section(self, start: int, stop: int) -> list[bytes]:
        """Return lines without their line ends, which must all be of one kind."""
        lines = self._lines[start:stop]
        returns = [text.endswith(b"\r") for text in lines]
        if not any(returns):
            return lines
        if not all(returns):
            wanted = returns[0]
            self._wrong_end(start + returns.index(not wanted), wanted, start)
        return [text[:-1] for text in lines]

    def _frame(self, line: int) -> bytes:
        """Return a line of the frame without its line end, which must be the same as in the first line."""
        text = self._lines[line]
        if line < len(self._lines) - 1 and text.endswith(b"\r") != self._returns:
            self._wrong_end(line, self._returns, 0)
        return text.removesuffix(b"\r")

    def _wrong_end(self, line: int, wanted: bool, like: int) -> NoReturn:
        actual, expected = ("LF", "CRLF") if wanted else ("CRLF", "LF")
        self._refuse(line, f"the line ends with {actual}, expected {expected} as in line {like + 1}")

    def _expect(self, line: int, text: bytes) -> None:
        if line >= len(self._lines) or self._frame(line) != text:
            self._unexpected(line, text)

    def _unexpected(self, line: int, text: bytes) -> NoReturn:
        actual = _shown(self._lines[line].removesuffix(b"\r")) if line < len(self._lines) else "the end of the file"
        self._refuse(line, f"expected {_shown(text)}, found {actual}")

    def _refuse(self, line: int, problem: str) -> NoReturn:
        refuse(self._where, line + 1, problem)


def _shown(line: bytes) -> str:
    """Return a line for messages, with everything but printable ASCII escaped."""
    if not line:
        return "a blank line"
    text = repr(line[:_SHOWN])[1:]
    return text if len(line) <= _SHOWN else f"{text}..."
