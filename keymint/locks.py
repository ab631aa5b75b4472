"""The lock of a workspace as readers hold it: shared, and only while they read their inputs into memory."""

from __future__ import annotations

import contextlib
import fcntl
import os
from collections.abc import Callable, Iterator
from pathlib import Path

LOCK = "lock"
"""Name of the file in the folder of records; see :meth:`keymint.store.Store.locked`."""


@contextlib.contextmanager
def shared(records: Path, on_wait: Callable[[], None]) -> Iterator[bool]:
    """Keep writers away while the workspace is read; several readers may hold this at once.

    Where there is no lock, or where it cannot be opened or locked, e.g. in a copy or on a read-only file system, the
    workspace is read anyway: nobody writes there under a lock either.

    Args:
        records: folder of the lock.
        on_wait: called once when a run that writes holds the lock, before waiting for it.

    Yields:
        Whether the lock is held.
    """
    try:
        lock = os.open(records / LOCK, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC | os.O_NONBLOCK)
    except OSError:
        yield False
        return
    try:
        yield _lock(lock, on_wait)
    finally:
        os.close(lock)


def _lock(lock: int, on_wait: Callable[[], None]) -> bool:
    try:
        fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        on_wait()
        fcntl.flock(lock, fcntl.LOCK_SH)
    except OSError:
        return False
    return True
