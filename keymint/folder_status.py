# SPDX-License-Identifier: Apache-2.0
"""The status of the files in a folder, which tells without reading them whether they are what they were.

A file that changes gets another change time (ctime), which no program can set. So the same inode, size, mode, owner and
times mean the same file, unless it changed twice within one tick of the file system's clock. The rule is that of git: a
status is trusted only if the clock had moved on before it was taken.
"""

from __future__ import annotations

import hashlib
import os
import stat
from collections.abc import Collection, Iterable
from typing import NamedTuple

NEVER = 1 << 63
"""In place of a time: the status of this folder is never trusted, e.g. because it contains a link."""
_SKIPPED = ".git"


class FolderStatus(NamedTuple):
    """The status of a folder and of the files directly in it.

    Attributes:
        digest: of mode and owner of the folder, and of name, mode, owner, size, times and inode of each file.
        newest: the latest time of any file, in nanoseconds.
        files: names of the files.
    """

    digest: str
    newest: int
    files: tuple[str, ...]

    def is_trusted(self, clock: int) -> bool:
        """Tell whether the same status means the same files.

        Args:
            clock: the clock of the file system before the status was taken, in nanoseconds.
        """
        return self.newest < clock


def walk(folders: Iterable[str]) -> dict[str, FolderStatus]:
    """Return the status of folders, and of all folders below them except ``.git``; none of those that do not exist."""
    found: dict[str, FolderStatus] = {}
    waiting = list(folders)
    while waiting:
        folder = waiting.pop()
        status = folder_status(folder, waiting)
        if status is not None:
            found[folder] = status
    return found


def folder_status(
    folder: str, below: list[str], written: Collection[str] = (), since: int = NEVER
) -> FolderStatus | None:
    """Return the status of a folder, or None if it does not exist.

    Args:
        folder: the folder.
        below: its subfolders are added to this list.
        written: names of files that this run wrote.
        since: if another file was modified after this time, the status is not trusted.
    """
    files: dict[str, str] = {}
    newest = 0
    try:
        own = os.stat(folder)  # noqa: PTH116 - of texts, because there are many
        rows = [f"{own.st_mode} {own.st_uid} {own.st_gid} {own.st_dev}"]
        with os.scandir(folder) as entries:
            for entry in entries:
                name, of = entry.name, entry.stat(follow_symlinks=False)
                if stat.S_ISDIR(of.st_mode):
                    if name != _SKIPPED:
                        below.append(entry.path)
                    continue
                if not stat.S_ISREG(of.st_mode) or (of.st_mtime_ns >= since and name not in written):
                    newest = NEVER
                newest = max(newest, of.st_mtime_ns, of.st_ctime_ns)
                files[name] = (
                    f"{name!r} {of.st_mode} {of.st_uid} {of.st_gid} {of.st_size} "
                    f"{of.st_mtime_ns} {of.st_ctime_ns} {of.st_ino}"
                )
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError:
        rows, newest = [], NEVER
    names = tuple(sorted(files))
    rows += (files[name] for name in names)
    return FolderStatus(hashlib.blake2b("\n".join(rows).encode(), digest_size=16).hexdigest(), newest, names)
