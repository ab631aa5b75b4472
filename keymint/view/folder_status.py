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
from collections.abc import Collection, Iterable, Mapping
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


def path_status(path: str) -> tuple[str, int]:
    """Return the status of a file or folder that may be anywhere, and its latest time; links are followed."""
    real = os.path.realpath(path)
    try:
        of = os.stat(real)  # noqa: PTH116 - of texts
    except OSError as error:
        return f"{real} {error.errno}", 0
    status = f"{real} {of.st_mode} {of.st_uid} {of.st_gid} {of.st_size} {of.st_mtime_ns} {of.st_ctime_ns} {of.st_ino}"
    return status, max(of.st_mtime_ns, of.st_ctime_ns)


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
    folder: str, below: list[str], written: Collection[str] = (), since: int = NEVER, visible: int = NEVER
) -> FolderStatus | None:
    """Return the status of a folder, or None if it does not exist.

    Args:
        folder: the folder.
        below: its subfolders are added to this list.
        written: names of files that this run wrote.
        since: if another file was modified after this time, the status is not trusted.
        visible: the same for the files that this run wrote: the time at which they appeared.
    """
    files: dict[str, tuple[int, ...]] = {}
    owner: tuple[int, ...] = ()
    newest = 0
    try:
        own = os.stat(folder)  # noqa: PTH116 - of texts, because there are many
        owner = own.st_mode, own.st_uid, own.st_gid, own.st_dev
        with os.scandir(folder) as entries:
            for entry in entries:
                name = entry.name
                if entry.is_dir(follow_symlinks=False):
                    if name != _SKIPPED:
                        below.append(entry.path)
                    continue
                of = entry.stat(follow_symlinks=False)
                if not stat.S_ISREG(of.st_mode) or of.st_mtime_ns >= (visible if name in written else since):
                    newest = NEVER
                newest = max(newest, of.st_mtime_ns, of.st_ctime_ns)
                files[name] = (
                    of.st_mode, of.st_uid, of.st_gid, of.st_size, of.st_mtime_ns, of.st_ctime_ns, of.st_ino,
                )  # fmt: skip
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError:
        newest = NEVER
    rows = repr((owner, sorted(files.items())))
    return FolderStatus(hashlib.blake2b(rows.encode(), digest_size=16).hexdigest(), newest, tuple(sorted(files)))


class Sight(NamedTuple):
    """The folders of a workspace as they are before a run reads a file.

    Attributes:
        roots: the folders that were looked at, with all that is below them.
        folders: the status of each folder.
        clock: the clock of the file system before that, in nanoseconds; 0 if it is not known.
    """

    roots: tuple[str, ...]
    folders: Mapping[str, FolderStatus]
    clock: int

    @classmethod
    def of(cls, folders: Iterable[str], clock: int = 0) -> Sight:
        """Look at folders and all that is below them."""
        roots = tuple(folders)
        return cls(roots, walk(roots), clock)

    def after(
        self, changes: Iterable[tuple[str, Iterable[str], Iterable[str]]], visible: int, clock: int
    ) -> Sight | None:
        """Return what is there when the run is done, or None if something else may have changed meanwhile.

        Args:
            changes: folders, perhaps more than once, with the names of the files that the run wrote and removed there.
            visible: the clock of the file system before the first write became visible.
            clock: the clock of the file system, later than the last write.
        """
        if not all(status.is_trusted(self.clock) for status in self.folders.values()):
            return None
        written: dict[str, set[str]] = {}
        removed: dict[str, set[str]] = {}
        for folder, new, gone in changes:
            written.setdefault(folder, set()).update(new)
            removed.setdefault(folder, set()).update(gone)
        folders = dict(self.folders)
        for folder in filter(self._has, {*written, *self._new_above(written)}):
            before, new = self.folders.get(folder), written.get(folder, set())
            present = folder_status(folder, [], new, self.clock, visible)
            if present is None:
                folders.pop(folder, None)
                continue
            kept = set(before.files if before else ()).difference(removed.get(folder, ()))
            if {*present.files} != kept | new or not present.is_trusted(clock):
                return None
            folders[folder] = present
        return Sight(self.roots, folders, clock)

    def _has(self, folder: str) -> bool:
        return f"{folder}/".startswith(tuple(f"{root}/" for root in self.roots))

    def _new_above(self, folders: Iterable[str]) -> set[str]:
        """Return the folders above new ones that are new as well."""
        new: set[str] = set()
        for folder in folders:
            above = folder if folder in self.roots else folder.rpartition("/")[0]
            while above not in self.folders and above not in new and self._has(above):
                new.add(above)
                above = above.rpartition("/")[0]
        return new
