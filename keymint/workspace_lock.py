# SPDX-License-Identifier: Apache-2.0
"""The workspace lock. Readers hold it only while they read their inputs into memory."""

from __future__ import annotations

import contextlib
import fcntl
import os
from collections.abc import Callable, Iterator
from pathlib import Path

LOCK = "lock"
"""Name of the lock file in the folder of records; writers take it with :meth:`keymint.store.Store.locked`."""


@contextlib.contextmanager
def read_lock(records: Path, on_wait: Callable[[], None]) -> Iterator[bool]:
    """Hold the workspace lock for reading, which keeps writers out but admits other readers.

    If the lock does not exist, or cannot be opened or locked (e.g. in a copy or on a read-only file system), the
    workspace is read without it: no writer can take the lock there either.

    Args:
        records: folder of the lock.
        on_wait: called once before waiting for a writer that holds the lock.

    Yields:
        Whether the lock is held.
    """
    try:
        lock = os.open(records / LOCK, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC | os.O_NONBLOCK)
    except OSError:
        yield False
        return
    locked = True
    try:
        try:
            wait_for_lock(lock, fcntl.LOCK_SH, on_wait)
        except OSError:
            locked = False
        yield locked
    finally:
        os.close(lock)


def wait_for_lock(lock: int, operation: int, on_wait: Callable[[], None]) -> None:
    """Lock an open file with ``LOCK_SH`` or ``LOCK_EX``; calls ``on_wait`` before waiting for another process."""
    try:
        fcntl.flock(lock, operation | fcntl.LOCK_NB)
    except BlockingIOError:
        on_wait()
        fcntl.flock(lock, operation)
