# SPDX-License-Identifier: Apache-2.0
"""The workspace lock, and that of a private space, which several workspaces may share.

Readers hold them only while they read their inputs into memory. All take the lock of the workspace first.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from time import sleep  # noqa: TID251 - waits, and does not tell the time

LOCK = "lock"
"""Name of the lock file in the folder of records; writers take it with :meth:`keymint.store.store.Store.locked`."""
_UNSUPPORTED = frozenset({errno.EBADF, errno.EINVAL, errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP})
"""What file systems say that lock no folders; see flock(2), "NFS details"."""


def read_lock(records: Path, on_wait: Callable[[], None]) -> AbstractContextManager[bool]:
    """Hold the workspace lock for reading, which keeps writers out but admits other readers.

    If the lock does not exist, or cannot be opened or locked (e.g. in a copy or on a read-only file system), the
    workspace is read without it: no writer can take the lock there either.

    Args:
        records: folder of the lock.
        on_wait: called once before waiting for a writer that holds the lock.

    Returns:
        A context whose value tells whether the lock is held.
    """
    return _held(records / LOCK, os.O_NONBLOCK, fcntl.LOCK_SH, on_wait)


def folder_lock(folder: Path, operation: int, on_wait: Callable[[], None]) -> AbstractContextManager[bool]:
    """Hold the lock of a folder itself, for which it needs no file.

    Args:
        folder: the folder; if it does not exist, cannot be opened, or its file system locks no folders (e.g. NFS, to
            write), it is not locked. To read, no other failure matters either.
        operation: ``LOCK_SH`` to read, ``LOCK_EX`` to write.
        on_wait: called once before waiting for another process that holds the lock.

    Returns:
        A context whose value tells whether the lock is held.

    Raises:
        OSError: it cannot be locked to write.
    """
    return _held(folder, os.O_DIRECTORY, operation, on_wait)


@contextlib.contextmanager
def _held(path: Path, flags: int, operation: int, on_wait: Callable[[], None]) -> Iterator[bool]:
    try:
        opened = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC | flags)
    except OSError:
        yield False
        return
    locked = True
    try:
        try:
            wait_for_lock(opened, operation, on_wait)
        except OSError as error:
            if operation == fcntl.LOCK_EX and error.errno not in _UNSUPPORTED:
                raise
            locked = False
        yield locked
    finally:
        os.close(opened)


def wait_for_lock(lock: int, operation: int, on_wait: Callable[[], None]) -> None:
    """Lock an open file with ``LOCK_SH`` or ``LOCK_EX``; calls ``on_wait`` before waiting for another process."""
    try:
        fcntl.flock(lock, operation | fcntl.LOCK_NB)
    except BlockingIOError:
        on_wait()
        fcntl.flock(lock, operation)


def clock(records: Path) -> int:
    """Return the clock of the file system, in nanoseconds: no file that changes from now on gets an earlier time.

    Files that changed before have an earlier time, unless the clock ticks in steps of more than some milliseconds.

    Args:
        records: folder of the lock, which the caller holds; if its times cannot be set, the result is 0.
    """
    try:
        before = now = _tick(records / LOCK)
        for _ in range(10):
            if now > before:
                break
            sleep(0.001)
            now = _tick(records / LOCK)
    except OSError:
        return 0
    return now


def _tick(file: Path) -> int:
    """Change a file in nothing but the time of its change, and return that."""
    status = file.stat()
    os.utime(file, ns=(status.st_atime_ns, status.st_mtime_ns))
    return file.stat().st_ctime_ns
