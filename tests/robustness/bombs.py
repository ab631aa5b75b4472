# SPDX-License-Identifier: Apache-2.0
# ruff: noqa: PLW0108 - files of megabytes, each made when it is tried
"""Small or permitted files that make a reader without bounds take far more memory than they are long."""

from __future__ import annotations

import base64
import contextlib
import sqlite3
from collections.abc import Callable, Mapping
from pathlib import Path

_FILE = (16 << 20) - 200
"""Bytes of the largest file that most readers take."""
_LARGE = 96 << 20

Bombs = Mapping[str, Callable[[], bytes]]


def filled(part: str | bytes, before: str | bytes = "", after: str | bytes = "", size: int = _FILE) -> bytes:
    """Return a file of this size with a part again and again."""
    begin, each, end = (text.encode() if isinstance(text, str) else text for text in (before, part, after))
    return begin + each * ((size - len(begin) - len(end)) // len(each)) + end


def xml(root: str, attributes: str = "") -> Bombs:
    """Return documents with this root."""
    begin, end = f"<{root}{attributes}>", f"</{root}>"
    return {
        "elements": lambda: (begin + "<a/>" * 990_000 + end).encode(),
        "elements without end": lambda: filled("<a/>", begin),
        "elements with attributes": lambda: filled("<a b='1' c='2'/>", begin, end),
        "elements with texts": lambda: (begin + "<a>1</a>" * 549_000 + end).encode(),
        "elements with namespaces": lambda: filled("<a xmlns:b='c'/>", begin, end),
        "attributes": lambda: (f"<{root} " + " ".join(f"a{at:x}=''" for at in range(1_300_000)) + "/>").encode(),
        "namespaces": lambda: (f"<{root} " + " ".join(f"xmlns:a{at:x}='b'" for at in range(800_000)) + "/>").encode(),
        "one attribute": lambda: filled("x", f"<{root} a='", "'/>"),
        "one text": lambda: filled("x", begin, end),
        "one name": lambda: filled("a", "<", "/>"),
        "a tag without end": lambda: filled("a", f"<{root} "),
        "depth": lambda: filled("<a>", begin),
        "references": lambda: filled("&#128512;", f"<{root} a='", "'/>"),
        "entities": lambda: (
            f"<!DOCTYPE {root} [<!ENTITY a0 'aaaaaaaaaa'>"
            + "".join(f"<!ENTITY a{at + 1} '{f'&a{at};' * 10}'>" for at in range(10))
            + f"]>{begin}&a10;{end}"
        ).encode(),
        "UTF-16": lambda: (begin + "x" * (_FILE // 2 - 100) + end).encode("utf-16"),
        "large": lambda: filled(" ", begin, end, _LARGE),
    }  # fmt: skip


_EDGES = '{"format":"keymint-graph","version":1,"edges":['
_EDGE = '{"subject":"/a","permission":"ros_publish","object":"/x"}'
GRAPHS: Bombs = {
    "lists": lambda: filled("[],", _EDGES, "[]]}"),
    "lists within the limit": lambda: (_EDGES + "[]," * 590_000 + "[]]}").encode(),
    "objects": lambda: filled("{},", _EDGES, "{}]}"),
    "objects within the limit": lambda: (_EDGES + '{"a":1},' * 390_000 + "{}]}").encode(),
    "numbers": lambda: filled("1,", _EDGES, "1]}"),
    "members": lambda: ("{" + ",".join(f'"{at:x}":0' for at in range(1_500_000)) + "}").encode(),
    "members within the limit": lambda: ("{" + ",".join(f'"{at:x}":0' for at in range(590_000)) + "}").encode(),
    "edges and a defect": lambda: (_EDGES + f"{_EDGE}," * 170_000 + "{}]}").encode(),
    "depth": lambda: filled("[", _EDGES),
    "depth of objects": lambda: filled('{"a":'),
    "a wide text": lambda: filled("x", _EDGES + '"\U0001f600', '"]}'),
    "a large number": lambda: filled("9", _EDGES, "]}"),
    "escapes": lambda: filled("\\ud83d\\ude00", _EDGES + '"', '"]}'),
    "not UTF-8": lambda: filled(b"\xff", _EDGES),
    "large": lambda: filled(" ", size=_LARGE),
}
_HEADER = "subject,kind,permission,object,qualifier,audit,source\n"
_ROW = "/a,ros_topic,ros_publish,/x,ALLOW,,\n"
TABLES: Bombs = {
    "fields": lambda: filled(",", _HEADER),
    "columns": lambda: filled("a,", "subject,kind,permission,"),
    "rows": lambda: filled("a\n", _HEADER),
    "rows and a defect": lambda: (_HEADER + _ROW * 199_000 + "a\n").encode(),
    "too many rows": lambda: (_HEADER + _ROW * 201_000).encode(),
    "a quote without end": lambda: filled("x\n", _HEADER + '"'),
    "quoted fields on many lines": lambda: filled('"\n",', _HEADER),
    "a wide text": lambda: filled("x", _HEADER + "\U0001f600"),
    "large": lambda: filled(" ", _HEADER, size=_LARGE),
}


def _database(select: str = "", made: str = "", blob: int = 0, mode: str = "DELETE") -> Callable[[], bytes]:
    """Return the maker of a database with a view, other content, and a blob of some bytes."""

    def content() -> bytes:
        path = Path("made.db")
        with contextlib.closing(sqlite3.connect(path, isolation_level=None)) as database:
            database.execute(f"PRAGMA journal_mode = {mode}")
            database.executescript(f"BEGIN; {made}; CREATE TABLE pad (x); COMMIT")
            database.execute("INSERT INTO pad VALUES (zeroblob(?))", (blob,))
            if select:
                columns = "subject, kind, permission, object, qualifier, audit, source"
                database.execute(f"CREATE VIEW rule({columns}) AS {select}")
        return path.read_bytes()

    return content


_ENDLESS = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) "


def _rows(value: str, tail: str = "") -> str:
    return f"SELECT '/s', 'ros_topic', 'ros_publish', {value}, 'ALLOW', 0, '' {tail}"


DATABASES: Bombs = {
    "rows without end": _database(_ENDLESS + _rows("'/x' || i", "FROM n")),
    "rows to sort": _database(_ENDLESS + _rows("'/x' || i", "FROM n ORDER BY 4")),
    "rows to compare": _database(f"{_ENDLESS} SELECT * FROM ({_rows('hex(zeroblob(8000)) || i', 'FROM n')}) UNION "
                                 + _rows("1")),
    "rows of tables": _database(_rows("1", "FROM t a, t b, t c, t d ORDER BY a.x || b.x || c.x || d.x"),
                                "CREATE TABLE t (x);" + "INSERT INTO t VALUES (hex(zeroblob(20)));" * 300),
    "a blob": _database(_rows("zeroblob(900000000)")),
    "a text": _database(_rows("printf('%.*c', 900000000, 'x')")),
    "texts": _database(_ENDLESS + _rows("hex(zeroblob(1000000)) || i", "FROM n")),
    "a replacement": _database(_rows("replace(hex(zeroblob(100000)), '0', hex(zeroblob(10000)))")),
    "a text of all": _database(_ENDLESS + _rows("(SELECT group_concat(hex(zeroblob(1000))) FROM n)")),
    "no view": _database(blob=30 << 20),
    "a large blob, read with a log": _database(_rows("(SELECT hex(x) FROM pad)"), blob=30 << 20, mode="WAL"),
    "large, and rows to sort": _database(_ENDLESS + _rows("'/x' || i", "FROM n ORDER BY 4"), blob=30 << 20, mode="WAL"),
    "tables": _database("", "".join(f"CREATE TABLE t{at}(a);" for at in range(7_500))),
    "large": _database(blob=_LARGE),
    "no database": lambda: filled(b"\0", b"SQLite format 3\0", size=32 << 20),
}  # fmt: skip


def der(tag: int, content: bytes) -> bytes:
    """Return a value in DER (X.690, 8.1)."""
    size = len(content).to_bytes((len(content).bit_length() + 7) // 8 or 1, "big")
    return bytes([tag]) + (size if len(content) < 128 else bytes([0x80 | len(size)]) + size) + content


def pem(label: str, content: bytes) -> bytes:
    return f"-----BEGIN {label}-----\n".encode() + base64.encodebytes(content) + f"-----END {label}-----\n".encode()


def nested(depth: int) -> bytes:
    """Return sequences in sequences, each with a length of four bytes."""
    return b"".join(b"\x30\x84" + (6 * left).to_bytes(4, "big") for left in reversed(range(depth)))


def certificates(one: bytes) -> Bombs:
    """Return files in the place of a certificate."""
    return {
        "certificates": lambda: filled(one),
        "empty blocks": lambda: filled(pem("CERTIFICATE", b"0\0")),
        "begins": lambda: filled("-----BEGIN CERTIFICATE-----\n"),
        "one large value": lambda: pem("CERTIFICATE", der(0x30, b"\0" * (11 << 20))),
        "many values": lambda: pem("CERTIFICATE", der(0x30, b"\5\0" * (5 << 20))),
        "depth": lambda: pem("CERTIFICATE", nested(1_500_000)),
        "a length beyond the file": lambda: pem("CERTIFICATE", b"\x30\x84\xff\xff\xff\xff"),
        "a length of many bytes": lambda: pem("CERTIFICATE", b"\x30\xff" + b"\xff" * (1 << 20)),
        "no lines": lambda: filled("x"),
        "lines": lambda: filled("\n"),
        "large": lambda: filled("x", size=_LARGE),
    }


def revocation_lists() -> Bombs:
    """Return files in the place of a revocation list."""
    algorithm = der(0x30, bytes.fromhex("06082a8648ce3d040302"))
    times = der(0x17, b"260101000000Z") + der(0x17, b"360101000000Z")

    def long(count: int) -> bytes:
        entries = b"".join(
            der(0x30, der(2, (1 + at).to_bytes(4, "big")) + der(0x17, b"260101000000Z")) for at in range(count)
        )
        listed = der(0x30, der(2, b"\1") + algorithm + der(0x30, b"") + times + der(0x30, entries))
        return pem("X509 CRL", der(0x30, listed + algorithm + der(3, b"\0" * 72)))

    return {
        "entries": lambda: long(450_000),
        "a million entries": lambda: long(1_000_000),
        "lists": lambda: filled(long(1)),
        "empty blocks": lambda: filled(pem("X509 CRL", b"0\0")),
        "depth": lambda: pem("X509 CRL", nested(1_500_000)),
        "a length beyond the file": lambda: pem("X509 CRL", b"\x30\x84\xff\xff\xff\xff"),
    }


def signed(one: bytes) -> Bombs:
    """Return files in the place of a signed document."""
    head, _, rest = one.partition(b"<dds")
    return {
        "elements": lambda: head + b"<dds>" + b"<a/>" * 990_000 + rest,
        "elements within the limit": lambda: head + b"<dds>" + b"<a/>" * 490_000 + rest,
        "attributes": lambda: head + b"<dds " + b" ".join(b"a%x=''" % at for at in range(1_300_000)) + b">" + rest,
        "headers": lambda: filled("a: b\n"),
        "folded headers": lambda: filled(" \n", "Content-Type: text/plain;\n"),
        "parts": lambda: filled(b"--" + _boundary(one) + b"\n\n", head),
        "lines": lambda: filled("\n", head),
        "lines that end as in mail": lambda: filled("\r\n", head.replace(b"\n", b"\r\n")),
        "a boundary": lambda: filled("x", 'MIME-Version: 1.0\nContent-Type: multipart/signed; boundary="'),
        "signatures": lambda: filled("MAAwADAA\n", one[: one.rindex(b"\n\n", 0, -200)] + b"\n\n"),
        "depth of the signature": lambda: pem("CMS", nested(1_500_000)),
        "no lines": lambda: filled("x"),
        "large": lambda: filled("x", size=_LARGE),
    }


def _boundary(document: bytes) -> bytes:
    return document.partition(b'boundary="')[2].partition(b'"')[0]


REQUESTS: Bombs = {
    "requests": lambda: filled(pem("CERTIFICATE REQUEST", b"0\0")),
    "within the limit": lambda: filled(pem("CERTIFICATE REQUEST", b"0\0"), size=60_000),
    "depth": lambda: pem("CERTIFICATE REQUEST", nested(7_000)),
    "a length beyond the file": lambda: pem("CERTIFICATE REQUEST", b"\x30\x84\xff\xff\xff\xff"),
    "large": lambda: filled("x", size=_LARGE),
}
