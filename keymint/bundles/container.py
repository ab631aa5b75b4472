# SPDX-License-Identifier: Apache-2.0
"""The file of a bundle: an uncompressed tar archive (POSIX.1-1988 ustar) in one canonical form.

Only the form that :func:`pack` writes is read. So names, sizes, modes, links, padding and what other readers
of tar may make of them need no rules of their own: a file with any other byte is refused.
"""

from __future__ import annotations

import io
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
    content = io.BytesIO()
    with tarfile.open(fileobj=content, mode="w", format=tarfile.USTAR_FORMAT) as archive:
        for name, data in sorted(members.items()):
            header = tarfile.TarInfo(name)
            header.size, header.mode = len(data), 0o600
            archive.addfile(header, io.BytesIO(data))
    packed = content.getvalue()
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
    try:
        with tarfile.open(fileobj=io.BytesIO(content), mode="r:") as archive:
            while (member := archive.next()) is not None:
                data = archive.extractfile(member) if member.isreg() and NAME.fullmatch(member.name) else None
                if data is None or len(members) == MAX_MEMBERS:
                    raise _refused("has an entry that no bundle has", where)
                members[member.name] = data.read(MAX_BYTES)
        canonical = pack(members) == content
    except (tarfile.TarError, ValueError, OverflowError, EOFError, MemoryError, OSError):
        canonical = False
    if not canonical:
        raise _refused("is not a bundle, or was truncated or altered", where)
    return members


def _refused(message: str, where: Origin) -> KeymintError:
    return KeymintError(message, where=where, help="copy it again from the authority", code="bundle-form")
