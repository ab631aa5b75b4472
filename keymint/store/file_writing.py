# SPDX-License-Identifier: Apache-2.0
"""Primitives of the store: create a file or folder, exchange names, synchronise, and report errors of the system.

Everything here works on names in a folder that is already open, so no symbolic link is followed.

Linux exchanges two names in one step (``renameat2`` with ``RENAME_EXCHANGE``; see renameat2(2)). Some file systems
cannot (NFS, some FUSE file systems), or not with each folder (overlayfs, for one in a lower layer: ``EXDEV``); see
:data:`UNABLE`.

Many files are synchronised by ``syncfs`` for the whole file system, a few by ``fsync`` one by one. ``syncfs`` waits for
the data of all programs, so it is worth it only for many files. It is used on local file systems and on Linux 5.8 or
newer, where it reports errors of writing (syncfs(2)). Servers of network file systems and FUSE programs need not
implement it, so files are synchronised one by one there. What is in memory (tmpfs) needs no call.
"""

from __future__ import annotations

import contextlib
import errno
import functools
import itertools
import os
import re
import stat
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path
from typing import Any, NoReturn

from comarmor.text import quote
from keymint.store.changes import File, file_mode
from keymint.view.file_reading import PREFIX, SUFFIX, file_error

FOLDER = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC
FILE = os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC | os.O_NONBLOCK
NEW_FILE = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
MAX_COMPONENT = 255
"""Bytes that common file systems allow in one component of a path."""
_serial = itertools.count()


@functools.cache
def c_function(name: str) -> Callable[..., int] | None:
    """Return a function of the C library that Python lacks, or None if the library lacks it, too."""
    try:
        found: Callable[..., int] = getattr(_ctypes().CDLL(None, use_errno=True), name)
    except (OSError, AttributeError):
        return None
    return found


def _ctypes() -> Any:
    return import_module("ctypes")  # it takes long, and few runs write many files or exchange names


def temporary() -> str:
    """Return a unique name that a sweep recognises as temporary."""
    return f"{PREFIX}{os.getpid()}-{next(_serial)}{SUFFIX}"


@contextlib.contextmanager
def open_at(name: str | Path, parent: int | None = None, flags: int = FOLDER) -> Iterator[int]:
    """Open a folder, or with other flags a file, relative to an open parent folder if given; not through a link."""
    descriptor = os.open(name, flags, 0o600, dir_fd=parent)
    try:
        yield descriptor
    finally:
        os.close(descriptor)


def create(
    folder: int, shown: str | Path, name: str, file: File, owner: tuple[int, int] | None = None
) -> os.stat_result | None:
    """Create a file, and return its status, or None for a link.

    Args:
        folder: the open folder.
        shown: its path, for messages.
        name: name of the new file.
        file: its content.
        owner: user and group to give it to, if the system permits that.
    """
    try:
        if file.link:
            os.symlink(file.link, name, dir_fd=folder)
            return None
        opened = os.open(name, NEW_FILE, file_mode(secret=file.secret or file.mode is not None), dir_fd=folder)
        try:
            return fill(opened, file, owner)
        finally:
            os.close(opened)
    except OSError as error:
        refuse(f"{shown}/{name}", error)


def fill(opened: int, file: File, owner: tuple[int, int] | None) -> os.stat_result:
    """Write a new file that is open, give it its owner and its mode, and return its status; see :func:`create`."""
    for piece in file.pieces():
        write_all(opened, piece)
    give(opened, owner)
    return with_mode(opened, file_mode(secret=file.secret) if file.mode is None else file.mode)


def with_mode(opened: int, mode: int) -> os.stat_result:
    """Give an open file or folder a mode if it has another one, as by the umask, and return its status."""
    status = os.fstat(opened)
    if stat.S_IMODE(status.st_mode) == mode:
        return status
    os.fchmod(opened, mode)
    return os.fstat(opened)


def write_all(opened: int, content: bytes) -> None:
    """Write more to an open file; the system may take several writes for it."""
    written = os.write(opened, content)
    while written < len(content):
        written += os.write(opened, memoryview(content)[written:])


def give(opened: int, owner: tuple[int, int] | None) -> None:
    """Give an open file or folder to a user and group; does nothing unless run as root."""
    if owner is not None:
        status = os.fstat(opened)
        if owner != (status.st_uid, status.st_gid):
            with contextlib.suppress(PermissionError):
                os.fchown(opened, *owner)


def make_folder(name: str | Path, mode: int, parent: int | None = None) -> None:
    """Create a folder with exactly this mode, independent of the umask."""
    os.mkdir(name, mode, dir_fd=parent)
    if stat.S_IMODE(os.stat(name, dir_fd=parent, follow_symlinks=False).st_mode) != mode:
        os.chmod(name, mode, dir_fd=parent)


def check_component(name: str, folder: str | Path) -> None:
    """Raise an error for text that cannot be the name of a file."""
    if name in {"", ".", ".."} or "/" in name or "\0" in name:
        raise file_error(folder, "confined", f"{name!r} is not a file name")
    if len(name) > MAX_COMPONENT // 4 and len(os.fsencode(name)) > MAX_COMPONENT:  # a character has at most 4 bytes
        raise file_error(folder, "confined", f"the name {quote(name, 40)} is longer than {MAX_COMPONENT} bytes")


def require_regular(folder: int, shown: str | Path, name: str, *, or_link: bool = False) -> os.stat_result | None:
    """Return the status of the regular file that is about to be replaced, or None if there is none.

    Args:
        folder: the open folder.
        shown: its path, for messages.
        name: name of the file.
        or_link: a symbolic link may be replaced as well; then None is returned.

    Raises:
        KeymintError: the name belongs to a symbolic link, a folder or another kind of file.
    """
    try:
        status = os.lstat(name, dir_fd=folder)
    except FileNotFoundError:
        return None
    if or_link and stat.S_ISLNK(status.st_mode):
        return None
    if not stat.S_ISREG(status.st_mode):
        kind = "a symbolic link" if stat.S_ISLNK(status.st_mode) else "not a regular file"
        message = f"is {kind}, so it is not replaced"
        raise file_error(f"{shown}/{name}", "symlink-refused", message, "remove it if it is not yours")
    return status


class reported(contextlib.AbstractContextManager["reported"]):  # noqa: N801 - used as a function
    """A context that turns an error of the system into a one-line error for the user.

    Args:
        path: what is read or written in it.
    """

    def __init__(self, path: str | Path) -> None:
        self._path = path

    def __exit__(self, kind: object, error: BaseException | None, traceback: object) -> None:
        if isinstance(error, OSError):
            refuse(self._path, error)


def refuse(path: str | Path, error: OSError) -> NoReturn:
    """Raise the error for a path that cannot be written."""
    path = Path(path)
    if error.errno == errno.ELOOP or (
        error.errno == errno.ENOTDIR and any(above.is_symlink() for above in (path, *path.parents))
    ):
        message, help_ = (
            "a symbolic link is in the way, which is refused",
            "remove it, or set the space with its option",
        )
        raise file_error(path, "symlink-refused", message, help_) from error
    helps = {
        errno.ENOSPC: "free some space and run again; the previous files are intact",
        errno.EDQUOT: "free some space and run again; the previous files are intact",
        errno.EACCES: "check the owner and mode of the folder",
        errno.EPERM: "check the owner and mode of the folder",
        errno.ENOTDIR: "a file is where a folder must be: name another folder",
        errno.EROFS: "the file system is mounted read-only",
    }
    message = f"cannot be written: {os.strerror(error.errno or 0)}"
    raise file_error(path, "write-failed", message, helps.get(error.errno or 0, "")) from error


def mount_of(opened: int) -> str:
    """Return an identifier of the mount of an open folder; one file system may be mounted more than once.

    Raises:
        OSError: the system does not tell it, although ``/proc`` is there.
    """
    with contextlib.suppress(FileNotFoundError), open(f"/proc/self/fdinfo/{opened}", encoding="utf-8") as info:  # noqa: PTH123
        for line in info:
            if line.startswith("mnt_id:"):
                return line
    return str(os.fstat(opened).st_dev)


_EXCHANGE = 2  # RENAME_EXCHANGE of <linux/fs.h>
UNABLE = {errno.EINVAL, errno.ENOSYS, errno.EXDEV, errno.EOPNOTSUPP, errno.EPERM}
"""Errors of a system that cannot exchange names; a filter of system calls refuses unknown ones with EPERM."""


def exchange_names(parent: int, one: str, other: str) -> None:
    """Exchange two names in an open folder in one step.

    Raises:
        OSError: the system refuses; nothing changed.
    """
    function = c_function("renameat2")
    if function is None:
        raise OSError(errno.ENOSYS, os.strerror(errno.ENOSYS))
    if function(parent, os.fsencode(one), parent, os.fsencode(other), _EXCHANGE):
        number = _ctypes().get_errno()
        raise OSError(number, os.strerror(number), one, None, other)


FEW = 64
"""Number of files up to which they are synchronised one by one."""
_LOCAL = frozenset({"bcachefs", "btrfs", "ext2", "ext3", "ext4", "f2fs", "overlay", "xfs", "zfs"})
_SINCE = (5, 8)


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
    kind = _kind_of(opened)
    if kind == "tmpfs":
        return True  # it is in memory
    function = _syncfs() if kind in _LOCAL else None
    if function is None:
        return False
    if function(opened):
        number = _ctypes().get_errno()
        if number in {errno.ENOSYS, errno.EPERM}:
            return False  # a filter of system calls refuses unknown ones
        raise OSError(number, os.strerror(number))
    return True


def _kind_of(opened: int) -> str:
    """Return the type of the file system of an open folder, or an empty text; see proc_pid_mountinfo(5)."""
    with contextlib.suppress(OSError):
        identifier = mount_of(opened).removeprefix("mnt_id:").strip()
        with open("/proc/self/mountinfo", encoding="utf-8", errors="replace") as lines:  # noqa: PTH123
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
    kind = os.lstat(name, dir_fd=parent).st_mode
    if stat.S_ISLNK(kind):
        return  # its folder contains it
    with open_at(name, parent, FILE) as opened:
        for entry in list(os.scandir(opened)) if stat.S_ISDIR(kind) else ():
            if entry.is_dir(follow_symlinks=False) or entry.is_file(follow_symlinks=False):
                sync_tree(opened, entry.name)
        os.fsync(opened)
