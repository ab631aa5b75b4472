# SPDX-License-Identifier: Apache-2.0
"""The file of a bundle: an uncompressed tar archive (POSIX.1-1988 ustar) in one canonical form.

Only the form that :func:`pack` writes is read. So names, sizes, modes, links, padding and what other readers
of tar may make of them need no rules of their own: a file with any other byte is refused. Each header is compared
before the data behind it is copied, because a reader of all forms of tar takes more memory than the file is long.
"""

from __future__ import annotations

import tarfile
from collections.abc import Mapping

from comarmor.errors import Origin
from comarmor.regex import lazy_regex
from keymint.errors import KeymintError

MAX_BYTES = 16 << 20
"""Largest bundle in bytes; documents of a subject have some thousand to some million."""
MAX_MEMBERS = 64
NAME = lazy_regex(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}")
"""The names of members: no folder, nothing hidden, and no longer than a header of tar has room for."""


def pack(members: Mapping[str, bytes]) -> bytes:
    """Return the archive of some files, sorted by name; every one has the mode 0600.

    Raises:
        ValueError: a name or the number or size of the files is not allowed.
    """
    if len(members) > MAX_MEMBERS or not all(map(NAME.fullmatch, members)):
        raise ValueError("members of a bundle")
    content = b"".join(
        part
        for name, data in sorted(members.items())
        for part in (_header(name, len(data)), data, bytes(-len(data) % tarfile.BLOCKSIZE))
    )
    size = len(content) + 2 * tarfile.BLOCKSIZE  # two empty blocks are the end
    packed = content.ljust(size + -size % tarfile.RECORDSIZE, b"\0")
    if len(packed) > MAX_BYTES:
        raise ValueError("size of a bundle")
    return packed


def unpack(content: bytes, where: Origin) -> Mapping[str, bytes]:
    """Return the files of an archive by name.

    Args:
        content: the archive.
        where: its file, for messages.

    Raises:
        KeymintError: it is not exactly what :func:`pack` writes; code ``bundle-form``.
    """
    if len(content) > MAX_BYTES:
        raise _refused(f"has {len(content):,} bytes, {MAX_BYTES:,} are the most", where)
    members: dict[str, bytes] = {}
    at = 0
    try:
        while content[at : at + 1].strip(b"\0") and len(members) < MAX_MEMBERS:
            begin = at + tarfile.BLOCKSIZE
            name = content[at : at + 100].rstrip(b"\0").decode("ascii")
            end = begin + int(content[at + 124 : at + 135], 8)
            is_ours = NAME.fullmatch(name) and name not in members and content[at:begin] == _header(name, end - begin)
            if not is_ours or end > len(content):
                raise _refused("has an entry that no bundle has", where)
            members[name] = content[begin:end]
            at = end + -end % tarfile.BLOCKSIZE
        canonical = pack(members) == content
    except ValueError:
        canonical = False
    if not canonical:
        raise _refused("is not a bundle, or was truncated or altered", where)
    return members


def _header(name: str, size: int) -> bytes:
    """Return the header of a file: 512 bytes, as POSIX.1-1988 has them.

    Raises:
        ValueError: the size is negative, or too large for a header.
    """
    header = tarfile.TarInfo(name)
    header.size, header.mode = size, 0o600
    return header.tobuf(tarfile.USTAR_FORMAT)


def _refused(message: str, where: Origin) -> KeymintError:
    return KeymintError(message, where=where, help="copy it again from the authority", code="bundle-form")
