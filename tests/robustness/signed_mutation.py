# SPDX-License-Identifier: Apache-2.0
# ruff: noqa: E501 - lists of what is tried
"""Mutates signed files where readers of S/MIME differ: boundaries, headers, parts, line ends. Deterministic for a seed."""

from __future__ import annotations

import base64
import random
import re
from collections.abc import Callable, Sequence

Random = random.Random
Pool = Sequence[bytes]
"""Other signed files, to take parts of."""

ENDS = (b"\n", b"\r\n")
BLANKS = (b" ", b"\t", b"  ", b"\x0b", b"\x0c", b"\xa0", b"\x1a", b"\x85", b"\r")
WORDS = (
    b"--", b"-", b"x", b"X", b"=", b";", b":", b'"', b"'", b"(", b")", b"(x)", b"\\", b",", b"\0", b"\xff", b".", b"_",
    b"\xef\xbb\xbf", b"%00", b"=20", b"=\n", b"\n", b"\r", b"\r\n", b"\n\n", b"From ", b"--\n", b"\x1b[1m",
)  # fmt: skip
HEADERS = (
    b"MIME-Version: 1.0", b"Content-Type: text/plain", b"Content-Type: text/html", b"Content-Type: multipart/mixed",
    b'Content-Type: multipart/signed; protocol="application/x-pkcs7-signature"; micalg="sha-256"; boundary="x"',
    b'Content-Type: multipart/signed; boundary="--"', b'Content-Type: multipart/signed; boundary=""',
    b"Content-Type: application/x-pkcs7-mime; smime-type=signed-data", b"Content-Type: application/x-pkcs7-signature",
    b"Content-Transfer-Encoding: base64", b"Content-Transfer-Encoding: 8bit",
    b"Content-Transfer-Encoding: quoted-printable", b"Content-Type:", b"Content-Type", b": x", b" x", b"\tx", b"Subject: x",
    b"content-type: text/plain", b"Content-Type : text/plain", b"Content-Type: TEXT/PLAIN", b"Content-Type: text/plain; x=y",
    b'Content-Type: text/plain; charset="utf-8"', b"Content-Type: (x) text/plain", b"Content-Length: 0",
)  # fmt: skip
_BOUNDARY = re.compile(rb'boundary="([^"\r\n]*)"')


def mutated(signed: bytes, pool: Pool, chance: Random) -> bytes:
    """Return a signed file with up to four changes, sometimes preceded by one that should not affect readers.

    Args:
        signed: the file.
        pool: files of the same signer.
        chance: decides.
    """
    if chance.random() < 0.3:
        signed = _harmless(signed, chance)
        if chance.random() < 0.5:
            return signed
    for _ in range(chance.choice((1, 1, 1, 2, 2, 3, 4))):
        signed = chance.choice(CHANGES)(signed, pool, chance)
    return signed


def _harmless(signed: bytes, chance: Random) -> bytes:
    kind = chance.randrange(4)
    if kind == 0:
        return signed.replace(b"\r\n", b"\n").replace(b"\n", chance.choice(ENDS))
    if kind == 1:
        return _both_types(signed, (), chance)
    if kind == 2:
        return signed + _end(signed) * chance.randint(1, 4)
    letters = b"abcXYZ0123456789-_.:=+?/"
    new = bytes(chance.choices(letters, k=chance.choice((1, 3, 7, 8, 9, 16, 40, 69, 70))))
    return signed.replace(separator(signed)[2:], new)


def separator(signed: bytes) -> bytes:
    """Return the text that separates the parts of a file."""
    found = _BOUNDARY.search(signed)
    return b"--" + (found[1] if found and found[1] else b"none")


def _end(signed: bytes) -> bytes:
    return b"\r\n" if signed[:200].count(b"\r\n") else b"\n"


def _lines(signed: bytes) -> list[bytes]:
    return signed.split(b"\n")


def _special(signed: bytes, chance: Random) -> int:
    """Return the index of a line of the MIME frame, or of any line."""
    lines, mark = _lines(signed), separator(signed)
    frame = [n for n, line in enumerate(lines) if mark in line or line.startswith((b"Content-", b"MIME", b"This"))]
    beside = [n + step for n in frame for step in (0, 0, 0, -1, 1) if 0 <= n + step < len(lines)]
    return chance.choice(beside) if beside and chance.random() < 0.8 else chance.randrange(len(lines))


def _edit(signed: bytes, chance: Random, change: Callable[[bytes], bytes | None]) -> bytes:
    lines, at = _lines(signed), _special(signed, chance)
    returned = lines[at].endswith(b"\r")
    found = change(lines[at].removesuffix(b"\r"))
    if found is None:
        del lines[at]
    else:
        lines[at] = found + b"\r" * returned
    return b"\n".join(lines)


# Separators.


def _behind_separator(signed: bytes, pool: Pool, chance: Random) -> bytes:
    """Insert text after, before or into one of the separators."""
    mark = separator(signed)
    places = [found.start() for found in re.finditer(re.escape(mark), signed)]
    if not places:
        return signed
    at, word = chance.choice(places), chance.choice((*WORDS, *BLANKS))
    where = at + chance.choice((0, len(mark), len(mark), len(mark), len(mark) + 2, 2, len(mark) - 1))
    return signed[:where] + word + signed[where:]


def _more_separators(signed: bytes, pool: Pool, chance: Random) -> bytes:
    mark = separator(signed)
    line = mark + chance.choice((b"", b"", b"--", b"--x", b"x", b" ", b"-", b"-- "))
    if chance.random() < 0.3:
        line = b"x" * chance.choice((1022, 1023, 1024, 2046, 1)) + line
    lines = _lines(signed)
    lines.insert(_special(signed, chance), line + (b"\r" if _end(signed) == b"\r\n" else b""))
    return b"\n".join(lines)


def _another_boundary(signed: bytes, pool: Pool, chance: Random) -> bytes:
    """Replace the boundary everywhere, or only in the header."""
    old = separator(signed)[2:]
    pieces = [line[2:].rstrip(b"\r") for line in _lines(signed) if line.startswith(b"--") and old not in line]
    new = chance.choice(
        (b"b", b"B0-_.", b"-", b"--", b"=", b"", b"a b", b"a ", b" a", b"a:b", b"a(b)", b"a'b", b"a\\b", b"a;b", b"X" * 70,
         b"X" * 71, b"X" * 1020, b"X" * 1030, old[:-1], old + b"-", old + b"--", old.lower(), b"MII", b"<", *pieces)
    )  # fmt: skip
    return signed.replace(old, new, chance.choice((1, 1, -1, -1, -1, 2, 3)))


def _boundary_syntax(signed: bytes, pool: Pool, chance: Random) -> bytes:
    old = separator(signed)[2:]
    quoted = b'boundary="' + old + b'"'
    new = chance.choice(
        (b"boundary=" + old, b"boundary='" + old + b"'", b'BOUNDARY="' + old + b'"', b'boundary = "' + old + b'"', b'boundary="' + old,
         quoted + b'; boundary="x"', b'boundary="x"; ' + quoted, quoted + b" ", quoted + b";", quoted + b" (x)", b"(x) " + quoted,
         b'boundary*="' + old + b'"', b'boundary*0="' + old + b'"', b'boundary=" ' + old + b'"', quoted.replace(b'="', b'="\\', 1))
    )  # fmt: skip
    return signed.replace(quoted, new, 1)


# Parts.


def _pieces(signed: bytes) -> list[bytes]:
    return signed.split(separator(signed))


def _spliced(signed: bytes, pool: Pool, chance: Random) -> bytes:
    """Insert the parts of another file before or after the file's own, between lines that look like separators."""
    other = chance.choice(pool)
    mark, end = separator(signed), _end(signed)
    parts, own = _pieces(other), _pieces(signed)
    if len(parts) < 4 or len(own) < 4:
        return signed
    like = [chance.choice((b"", b"x", b" ", b"-", b"\t")) for _ in range(3)]
    inserted = mark + like[0] + parts[1] + mark + like[1] + parts[2]
    final = mark + chance.choice((b"--", b"--", b"-- ", b"--x", b"", b"-", b"x")) + chance.choice((b"", end))
    if chance.random() < 0.6:
        return own[0] + inserted + final + chance.choice((b"", mark)) + mark.join(own[1:])
    at = chance.randint(1, len(own) - 1)
    return mark.join(own[:at]) + inserted + final + mark.join([b"", *own[at:]])


def _other_file(signed: bytes, pool: Pool, chance: Random) -> bytes:
    """Insert another complete file before, after, or at a line."""
    other = chance.choice(pool)
    if chance.random() < 0.3:
        other = other.replace(separator(other), separator(signed)).replace(separator(other)[2:], separator(signed)[2:])
    lines = _lines(signed)
    at = chance.choice((0, len(lines), 3, 4, 5, _special(signed, chance)))
    return b"\n".join([*lines[:at], *_lines(other), *lines[at:]])


def _parts_shuffled(signed: bytes, pool: Pool, chance: Random) -> bytes:
    mark, pieces = separator(signed), _pieces(signed)
    kind = chance.randrange(4)
    if kind == 0:
        chance.shuffle(pieces)
    elif kind == 1:
        pieces.insert(chance.randrange(len(pieces) + 1), chance.choice(pieces))
    elif kind == 2:
        del pieces[chance.randrange(len(pieces))]
    else:
        other = _pieces(chance.choice(pool))
        at = chance.randrange(len(pieces))
        pieces[at] = other[min(at, len(other) - 1)]
    return mark.join(pieces)


# Headers and lines.


def _headers(signed: bytes, pool: Pool, chance: Random) -> bytes:
    lines = _lines(signed)
    lines.insert(_special(signed, chance), chance.choice(HEADERS) + (b"\r" if _end(signed) == b"\r\n" else b""))
    return b"\n".join(lines)


def _header_changed(signed: bytes, pool: Pool, chance: Random) -> bytes:
    def change(line: bytes) -> bytes:
        return chance.choice(
            (line.lower(), line.upper(), b" " + line, line + b" ", line.replace(b": ", b":", 1), line.replace(b":", b" :", 1),
             line.replace(b"; ", b";\n ", 1), line.replace(b"; ", b";", 1), line.replace(b'"', b""), line.replace(b'"', b"'"),
             line + b"; x=y", line.replace(b"x-pkcs7", b"pkcs7"), line.replace(b"pkcs7", b"x-pkcs7"), line.replace(b"sha-256", b"sha-512"),
             line.replace(b"sha-256", b"sha1"), line.replace(b"base64", b"BASE64"), line.replace(b"base64", b"7bit"), line + b" (x)",
             line.replace(b"/", b"/x"), line.replace(b"signed", b"mixed"), line.replace(b"1.0", b"1.1"), line.replace(b"plain", b"PLAIN"))
        )  # fmt: skip

    return _edit(signed, chance, change)


def _both_types(signed: bytes, pool: Pool, chance: Random) -> bytes:
    if b"application/x-pkcs7" in signed:
        return signed.replace(b"application/x-pkcs7", b"application/pkcs7")
    return signed.replace(b"application/pkcs7", b"application/x-pkcs7")


def _lines_moved(signed: bytes, pool: Pool, chance: Random) -> bytes:
    lines, at = _lines(signed), _special(signed, chance)
    kind = chance.randrange(4)
    if kind == 0:
        del lines[at]
    elif kind == 1:
        lines.insert(at, lines[at])
    elif kind == 2:
        lines.insert(_special(signed, chance), lines.pop(at))
    else:
        lines.insert(at, chance.choice((b"", b"\r", b" ", b"x", b"\0", b"x" * 1023, b"x" * 5000)))
    return b"\n".join(lines)


def _line_changed(signed: bytes, pool: Pool, chance: Random) -> bytes:
    word = chance.choice((*WORDS, *BLANKS))
    return _edit(
        signed, chance, lambda line: chance.choice((line + word, word + line, word, line[:-1], line[1:], line * 2))
    )


# The file as a whole.


def _in_front(signed: bytes, pool: Pool, chance: Random) -> bytes:
    return (
        chance.choice(
            (b"\n", b"\r\n", b" ", b"x\n", b"\xef\xbb\xbf", b"\0", b"Subject: x\n", b"x" * 1023, b"\r", b"\n\n")
        )
        + signed
    )


def _behind(signed: bytes, pool: Pool, chance: Random) -> bytes:
    more = (
        b"\n",
        b"\r\n",
        b"\n\n\n",
        b" ",
        b"x",
        b"x\n",
        b"\0",
        b"--\n",
        separator(signed),
        separator(signed) + b"--\n",
        b"\x1a",
    )
    return signed + b"".join(chance.choice(more) for _ in range(chance.randint(1, 3)))


def _cut(signed: bytes, pool: Pool, chance: Random) -> bytes:
    near = len(signed) - chance.randint(0, 60)
    return signed[: chance.choice((near, near, near, chance.randint(0, len(signed))))]


def _ends(signed: bytes, pool: Pool, chance: Random) -> bytes:
    """Change all line ends, those of one part, several, or one."""
    kind = chance.randrange(7)
    if kind <= 1:
        return signed.replace(b"\r\n", b"\n").replace(b"\n", ENDS[kind])
    if kind == 2:
        return signed.replace(b"\r\n", b"\n").replace(b"\n", chance.choice((b"\r", b"\r\r\n", b"\n\r")))
    if kind <= 4:
        mark, pieces = separator(signed), _pieces(signed)
        at = chance.randrange(len(pieces))
        pieces[at] = pieces[at].replace(b"\r\n", b"\n").replace(b"\n", ENDS[kind - 3])
        return mark.join(pieces)
    lines = _lines(signed)
    for at in [_special(signed, chance)] if kind == 5 else range(len(lines)):
        if kind == 5 or chance.random() < 0.5:
            lines[at] = lines[at][:-1] if lines[at].endswith(b"\r") else lines[at] + b"\r"
    return b"\n".join(lines)


def _bytes(signed: bytes, pool: Pool, chance: Random) -> bytes:
    if not signed:
        return signed
    at = chance.randrange(len(signed))
    changed = (
        bytes([signed[at] ^ 1 << chance.randrange(8)]) if chance.random() < 0.5 else chance.choice((*WORDS, *BLANKS))
    )
    return signed[:at] + changed + signed[at + chance.randint(0, 1) :]


def _encoded(signed: bytes, pool: Pool, chance: Random) -> bytes:
    kind = chance.randrange(4)
    if kind == 0:
        return signed.decode("latin-1").encode(chance.choice(("utf-16", "utf-16-le", "utf-8-sig", "utf-8")))
    pieces = _pieces(signed)
    if len(pieces) < 4:
        return signed
    head, _, body = pieces[1].replace(b"\r\n", b"\n").partition(b"\n\n")
    if kind == 1:
        pieces[1] = head + b"\nContent-Transfer-Encoding: base64\n\n" + base64.encodebytes(body)
    elif kind == 2:
        pieces[1] = head + b"\nContent-Transfer-Encoding: quoted-printable\n\n" + body.replace(b"=", b"=3D")
    else:
        return base64.encodebytes(signed)
    return separator(signed).join(pieces)


# The signature.


def _base64(signed: bytes, pool: Pool, chance: Random) -> bytes:
    """Encode the same, or almost the same, signature differently."""
    found = re.search(rb"(?s)(filename=\"smime.p7s\"\r?\n\r?\n)(.*?)(\r?\n\r?\n--)", signed)
    if found is None:
        return signed
    text = found[2]
    end = b"\r\n" if b"\r\n" in text else b"\n"
    plain = text.replace(b"\r", b"").replace(b"\n", b"")
    width = chance.choice((1, 4, 60, 63, 65, 68, 76, 80, 128, 1000, 1024, 5000))
    at = chance.randrange(len(text)) if text else 0
    new = chance.choice(
        (end.join(plain[n : n + width] for n in range(0, len(plain), width)), text[:at] + chance.choice((*WORDS, *BLANKS)) + text[at:],
         text + b"=", text.rstrip(b"="), text + end, end + text, text + end + b"x", text.replace(b"+", b"-").replace(b"/", b"_"), text[:-4],
         text + end + b"MII=", text.replace(end, chance.choice(ENDS)), b"x" + end + text, b" " + text, text + b"====", _loose_bits(text))
    )  # fmt: skip
    return signed[: found.start(2)] + new + signed[found.end(2) :]


def _loose_bits(text: bytes) -> bytes:
    """Set bits that base64 does not use."""
    body = text.rstrip(b"=")
    return body if body == text or not body else body[:-1] + bytes([body[-1] + 1]) + b"=" * (len(text) - len(body))


def _der(signed: bytes, pool: Pool, chance: Random) -> bytes:
    """Change the bytes of the signature."""
    found = re.search(rb"(?s)(filename=\"smime.p7s\"\r?\n\r?\n)(.*?)(\r?\n\r?\n--)", signed)
    try:
        raw = base64.b64decode(found[2]) if found else b""
    except ValueError:
        raw = b""
    if found is None or len(raw) < 100:
        return signed
    at, kind = chance.randrange(len(raw)), chance.randrange(5)
    if kind == 0:
        raw = raw[:at] + bytes([raw[at] ^ 1 << chance.randrange(8)]) + raw[at + 1 :]
    elif kind == 1:
        raw += chance.choice((b"\0", b"\0\0", b"x", raw))
    elif kind == 2:
        raw = raw[:1] + b"\x80" + raw[4:] + b"\0\0"
    elif kind == 3:
        raw = raw[:1] + b"\x83\0" + raw[2:4] + raw[4:]
    else:
        raw = raw[:at] + raw[at + 1 :]
    text = base64.b64encode(raw)
    lines = _end(found[2]).join(text[n : n + 64] for n in range(0, len(text), 64))
    return signed[: found.start(2)] + lines + signed[found.end(2) :]


CHANGES: tuple[Callable[[bytes, Pool, Random], bytes], ...] = (
    _behind_separator, _behind_separator, _more_separators, _more_separators, _another_boundary, _another_boundary,
    _boundary_syntax, _spliced, _spliced, _spliced, _other_file, _other_file, _parts_shuffled, _headers, _headers,
    _header_changed, _header_changed, _both_types, _lines_moved, _lines_moved, _line_changed, _in_front, _behind, _behind,
    _cut, _ends, _ends, _ends, _bytes, _encoded, _base64, _der,
)  # fmt: skip
