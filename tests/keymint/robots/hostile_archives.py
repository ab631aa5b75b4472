# SPDX-License-Identifier: Apache-2.0
"""Archives that make readers of tar take more than they were sent, or another file than they show."""

from __future__ import annotations

import bz2
import gzip
import lzma
import tarfile
from collections.abc import Callable, Mapping

from keymint.robots import bundle

_FIELDS = {
    "name": 0, "mode": 100, "uid": 108, "size": 124, "time": 136, "checksum": 148, "kind": 156, "link": 157,
    "magic": 257, "user": 265, "device": 329, "prefix": 345, "sparse": 386,
}  # fmt: skip
"""Where each field of a header begins; that of GNU tar for sparse files lies in the prefix."""


def header(name: bytes = b"a", size: bytes | int = 1, **fields: bytes) -> bytes:
    """Return a header of tar (POSIX.1-1988) with other values in some fields; without one, the checksum is right."""
    written = bytearray(tarfile.TarInfo("").tobuf(tarfile.USTAR_FORMAT))
    written[100:108] = b"0000600\0"
    values = {"name": name, "size": size if isinstance(size, bytes) else octal(size), **fields}
    for field, value in values.items():
        written[_FIELDS[field] : _FIELDS[field] + len(value)] = value
    if "checksum" not in fields:
        written[148:156] = b"%06o\0 " % (sum(written[:148]) + sum(written[156:]) + 8 * 32)
    return bytes(written)


def octal(number: int) -> bytes:
    return b"%011o\0" % number


def padded(data: bytes) -> bytes:
    return data + b"\0" * (-len(data) % 512)


def ended(*blocks: bytes) -> bytes:
    """Return an archive of some blocks, with the end that archives have."""
    content = b"".join(blocks) + b"\0" * 1024
    return content + b"\0" * (-len(content) % tarfile.RECORDSIZE)


ONE = header() + padded(b"x")
"""A file called ``a``."""


def records(values: Mapping[str, str]) -> bytes:
    """Return the records of a header of pax (POSIX.1-2001)."""
    written = b""
    for key, value in values.items():
        rest = len(f" {key}={value}\n".encode())
        size = next(size for size in range(rest, rest + 9) if rest + len(str(size)) == size)
        written += f"{size} {key}={value}\n".encode()
    return written


HUGE = (8 << 30) - 1
SPARSE = octal(1 << 30) + octal(0) + b"\0" * 73 + octal(1 << 30)
"""The fields of a sparse member of GNU tar that has 1 GiB, and nothing of it in the file."""


def pax(values: Mapping[str, str], data: bytes = b"x", kind: bytes = b"x", copies: int = 60) -> bytes:
    """Return an archive whose members have further headers of pax."""
    written = records(values)
    extended = header(b"a", len(written), kind=kind)
    return ended(*(extended, padded(written), header(b"a", len(data)), padded(data)) * copies)


GIB = str(1 << 30)
COMPRESSED = gzip.compress(b"x" * 100, mtime=0)
MAP = padded(f"1\n{GIB}\n0\n".encode())
ARCHIVES: Mapping[str, Callable[[], bytes]] = {
    "our form, as written here": lambda: ended(ONE),
    "GNU-sparse": lambda: ended(*[header(size=0, kind=b"S", sparse=SPARSE)] * 64),
    "PAX-sparse 0.0": lambda: pax({"GNU.sparse.size": GIB, "GNU.sparse.numblocks": "1",
                                   "GNU.sparse.offset": GIB, "GNU.sparse.numbytes": "0"}),
    "PAX-sparse 0.1": lambda: pax({"GNU.sparse.size": GIB, "GNU.sparse.numblocks": "1", "GNU.sparse.map": f"{GIB},0"}),
    "PAX-sparse 1.0": lambda: pax({"GNU.sparse.major": "1", "GNU.sparse.minor": "0", "GNU.sparse.name": "a",
                                   "GNU.sparse.realsize": GIB}, MAP),
    "PAX-sparse 1.0 with a map of the whole file": lambda: pax(
        {"GNU.sparse.major": "1", "GNU.sparse.minor": "0", "GNU.sparse.realsize": GIB}, padded(b"9\n" * 10**6),
        copies=1,
    ),
    "PAX-sparse for all members": lambda: pax({"GNU.sparse.map": f"{GIB},0", "GNU.sparse.size": GIB}, kind=b"g"),
    "a size of pax": lambda: pax({"size": GIB}),
    "a negative size of pax": lambda: pax({"size": "-512"}),
    "a header of pax that fills the file": lambda: pax({"comment": "x" * (15 << 20)}, copies=1),
    "a header of pax that is larger than the file": lambda: ended(header(size=HUGE, kind=b"x")),
    "a long name of GNU": lambda: ended(header(size=9, kind=b"L"), padded(b"../../a\0\0"), ONE),
    "a long name of GNU that is larger than the file": lambda: ended(header(size=HUGE, kind=b"L")),
    "a long link of GNU": lambda: ended(header(size=9, kind=b"K"), padded(b"../../a\0\0"), ONE),
    "a header of Solaris": lambda: pax({"path": "../a"}, kind=b"X"),
    "members over several archives": lambda: ended(header(kind=b"M"), padded(b"x")),
    "a folder's dump": lambda: ended(header(kind=b"D"), padded(b"x")),
    "a volume's name": lambda: ended(header(size=0, kind=b"V")),
    "a contiguous file": lambda: ended(header(kind=b"7"), padded(b"x")),
    "the kind of 1979": lambda: ended(header(kind=b"\0"), padded(b"x")),
    "an unknown kind": lambda: ended(header(kind=b"Z"), padded(b"x")),
    "a size in base 256": lambda: ended(header(size=b"\x80" + b"\0" * 10 + b"\1"), padded(b"x")),
    "a huge size in base 256": lambda: ended(header(size=b"\x80" + b"\xff" * 11), padded(b"x")),
    "a negative size in base 256": lambda: ended(header(size=b"\xff" * 11 + b"\0"), padded(b"x")),
    "a negative size": lambda: ended(header(size=b"-0000000777\0"), padded(b"x")),
    "a size with a sign": lambda: ended(header(size=b"+0000000001\0"), padded(b"x")),
    "a size with underscores": lambda: ended(header(size=b"000000_0001\0"), padded(b"x")),
    "a size with blanks": lambda: ended(header(size=b"          1\0"), padded(b"x")),
    "a size without an end": lambda: ended(header(size=b"000000000001"), padded(b"x")),
    "a size that is not octal": lambda: ended(header(size=b"00000000009\0"), padded(b"x")),
    "no size": lambda: ended(header(size=b"\0" * 12), padded(b"x")),
    "a size beyond the file": lambda: ended(header(size=b"%011o\0" % 10_240), padded(b"x")),
    "the largest size": lambda: ended(header(size=b"7" * 11 + b"\0"), padded(b"x")),
    "a size to the end of the file": lambda: ended(header(size=10_240 - 512), padded(b"x")),
    "a member in the padding": lambda: ended(header(), b"x" + header()[1:], ONE),
    "a member behind the end": lambda: ended(ONE, b"\0" * 1024, header(b"b"), padded(b"x")),
    "one empty block": lambda: ended(ONE, b"\0" * 512, header(b"b"), padded(b"x")),
    "a wrong checksum": lambda: ended(header(checksum=b"000000\0 "), padded(b"x")),
    "a signed checksum": lambda: ended(header(checksum=b"-00001\0 "), padded(b"x")),
    "another form of the checksum": lambda: ended(header(checksum=header()[148:154] + b" \0"), padded(b"x")),
    "a prefix": lambda: ended(header(prefix=b"../.."), padded(b"x")),
    "a prefix behind an end": lambda: ended(header(prefix=b"\0../.."), padded(b"x")),
    "a name with something behind its end": lambda: ended(header(b"a\0../b"), padded(b"x")),
    "a name with a line end": lambda: ended(header(b"a\n"), padded(b"x")),
    "a name that is not ASCII": lambda: ended(header("\u00e4".encode()), padded(b"x")),
    "a name that is not UTF-8": lambda: ended(header(b"a\xff"), padded(b"x")),
    "a link's target": lambda: ended(header(link=b"b"), padded(b"x")),
    "a device": lambda: ended(header(device=b"0000001\0"), padded(b"x")),
    "the magic of GNU": lambda: ended(header(magic=b"ustar  \0"), padded(b"x")),
    "no magic": lambda: ended(header(magic=b"\0" * 8), padded(b"x")),
    "something behind the header": lambda: ended(header()[:500] + b"x" * 12, padded(b"x")),
    "a member twice, once longer": lambda: ended(ONE, header(size=600), padded(b"x" * 600)),
    "empty members without end": lambda: ended(header(size=0) * 32_000),
    "tiny members without end": lambda: ended(*(header(b"%06d" % each) + padded(b"x") for each in range(16_000))),
    "no end": lambda: ONE,
    "no member": ended,
    "zeros": lambda: b"\0" * bundle.MAX_BYTES,
    "ones": lambda: b"\xff" * bundle.MAX_BYTES,
    "gzip": lambda: gzip.compress(b"\0" * (64 << 20)),
    "gzip of gzip": lambda: gzip.compress(gzip.compress(b"\0" * (64 << 20))),
    "bzip2": lambda: bz2.compress(b"\0" * (64 << 20)),
    "xz": lambda: lzma.compress(b"\0" * (64 << 20)),
    "a member that is gzip": lambda: ended(header(b"a", len(COMPRESSED)), padded(COMPRESSED)),
}  # fmt: skip
KEPT = {"our form, as written here": {"a": b"x"}, "no member": {}, "a member that is gzip": {"a": COMPRESSED}}
"""What is an archive of ours: a compressed file in it stays as it is."""
