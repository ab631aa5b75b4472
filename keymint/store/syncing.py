# SPDX-License-Identifier: Apache-2.0
"""Make what was written durable: many files by ``syncfs`` for the whole file system, a few by ``fsync`` one by one.

``syncfs`` waits for the data of all programs, so it is worth it only for many files. It is used on local file systems
and on Linux 5.8 or newer, where it reports errors of writing (syncfs(2)). Servers of network file systems and FUSE
programs need not implement it, so files are synchronised one by one there.
"""

from __future__ import annotations

import contextlib
import ctypes
import errno
import functools
import os
import re
from collections.abc import Callable

from keymint.store.file_writing import FOLDER, c_function
from keymint.store.folder_staging import mount_of

FEW = 64
"""Number of files up to which they are synchronised one by one."""
_LOCAL = frozenset({"bcachefs", "btrfs", "ext2", "ext3", "ext4", "f2fs", "overlay", "tmpfs", "xfs", "zfs"})
_SINCE = (5, 8)
_READ = os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC | os.O_NONBLOCK


@functools.cache
def _syncfs() -> Callable[[int], int] | None:
    """Return the function of the C library, or None if the system has none that reports errors."""
    release = re.match(r"(\d+)\.(\d+)", os.uname().release)
    if os.uname().sysname != "Linux" or release is None or tuple(map(int, release.groups())) < _SINCE:
        return None
    return c_function("syncfs")


def sync_file_system(opened: int) -> bool:
    """Synchronise the file system of an open folder.

    Returns:
        False if it must be synchronised file by file instead.

    Raises:
        OSError: the system could not write everything.
    """
    function = _syncfs()
    if function is None or _kind_of(mount_of(opened)) not in _LOCAL:
        return False
    if function(opened):
        number = ctypes.get_errno()
        if number in {errno.ENOSYS, errno.EPERM}:
            return False  # a filter of system calls refuses unknown ones
        raise OSError(number, os.strerror(number))
    return True


def _kind_of(mount: str) -> str:
    """Return the type of a mounted file system; see proc_pid_mountinfo(5)."""
    identifier = mount.removeprefix("mnt_id:").strip()
    with contextlib.suppress(OSError), open("/proc/self/mountinfo", encoding="utf-8", errors="replace") as lines:  # noqa: PTH123
        for line in lines:
            fields, _, kind = line.partition(" - ")
            if fields.split(" ", 1)[0] == identifier:
                return kind.split(" ", 1)[0]
    return ""


def sync_tree(parent: int, name: str) -> None:
    """Synchronise a file, or a folder with everything in it.

    Raises:
        OSError: the system could not write everything.
    """
    try:
        folder = os.open(name, FOLDER, dir_fd=parent)
    except NotADirectoryError:
        _sync_file(parent, name)
        return
    except OSError as error:
        if error.errno != errno.ELOOP:
            raise
        return  # a symbolic link, which its folder contains
    try:
        for entry in list(os.scandir(folder)):
            if entry.is_dir(follow_symlinks=False):
                sync_tree(folder, entry.name)
            elif entry.is_file(follow_symlinks=False):
                _sync_file(folder, entry.name)
        os.fsync(folder)
    finally:
        os.close(folder)


def _sync_file(folder: int, name: str) -> None:
    file = os.open(name, _READ, dir_fd=folder)
    try:
        os.fsync(file)
    finally:
        os.close(file)
