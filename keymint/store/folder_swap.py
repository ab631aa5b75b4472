# SPDX-License-Identifier: Apache-2.0
"""Replace a folder with a complete new one, atomically where the file system can.

Linux exchanges two names at once (``renameat2`` with ``RENAME_EXCHANGE``; see renameat2(2)). If a file system cannot
(NFS, some FUSE file systems), or not with this folder (overlayfs, for one in a lower layer: ``EXDEV``), the old folder
is removed first. Then the folder is missing for a moment, but old and new files are never mixed. Meanwhile the new
folder waits in a folder of its own, so that a sweep after a kill can put it into place; see :func:`finish`.
"""

from __future__ import annotations

import contextlib
import ctypes
import errno
import os
import shutil

from keymint.store.file_writing import PREFIX, c_function, opened_folder, temporary

WAITING = ".next"
"""Suffix of the folder in which a complete new folder waits."""
_EXCHANGE = 2  # RENAME_EXCHANGE of <linux/fs.h>
_UNABLE = {errno.EINVAL, errno.ENOSYS, errno.EXDEV, errno.EOPNOTSUPP, errno.EPERM}
"""Errors of a system that cannot exchange names; a filter of system calls refuses unknown ones with EPERM."""


def exchange(parent: int, one: str, other: str) -> None:
    """Exchange two names in an open folder in one step.

    Raises:
        OSError: the system refuses; nothing changed.
    """
    function = c_function("renameat2")
    if function is None:
        raise OSError(errno.ENOSYS, os.strerror(errno.ENOSYS))
    if function(parent, os.fsencode(one), parent, os.fsencode(other), _EXCHANGE):
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number), one, None, other)


def swap_in(parent: int, staged: str, name: str) -> str | None:
    """Replace a folder with a complete, synchronised one.

    Args:
        parent: the open parent folder of both.
        staged: name of the new folder.
        name: name of the old folder, and of the new one afterwards.

    Returns:
        The name that the old folder has now; None if it is already removed.

    Raises:
        OSError: the system refuses; the old folder is unchanged.
    """
    try:
        exchange(parent, staged, name)
    except OSError as error:
        if error.errno not in _UNABLE:
            raise
        return _replace(parent, staged, name)
    return staged


def _replace(parent: int, staged: str, name: str) -> str | None:
    """Replace a folder where names cannot be exchanged; it is missing for a moment."""
    waiting = temporary(WAITING)
    os.mkdir(waiting, 0o700, dir_fd=parent)
    with opened_folder(waiting, parent) as inner:
        os.rename(staged, name, src_dir_fd=parent, dst_dir_fd=inner)
        os.fsync(inner)
        os.fsync(parent)
        old: str | None = temporary()
        try:
            os.rename(name, str(old), src_dir_fd=parent, dst_dir_fd=parent)
        except OSError as error:
            if error.errno != errno.EXDEV:
                os.rename(name, staged, src_dir_fd=inner, dst_dir_fd=parent)
                os.rmdir(waiting, dir_fd=parent)
                raise
            shutil.rmtree(name, dir_fd=parent)  # overlayfs cannot rename a folder of a lower layer, but can remove it
            old = None
        os.rename(name, name, src_dir_fd=inner, dst_dir_fd=parent)
    os.rmdir(waiting, dir_fd=parent)
    return old


def is_waiting(name: str) -> bool:
    """Tell whether a folder of this name contains a new folder that waits."""
    return name.startswith(PREFIX) and name.endswith(WAITING)


def finish(parent: int, waiting: str) -> None:
    """Put the folder into place that a killed run left waiting; it may be the only complete copy.

    Args:
        parent: the open parent folder.
        waiting: name of the folder that contains it.

    Raises:
        OSError: the system refuses.
    """
    with opened_folder(waiting, parent) as inner:
        for name in os.listdir(inner):
            with contextlib.suppress(FileNotFoundError):
                shutil.rmtree(name, dir_fd=parent)
            os.rename(name, name, src_dir_fd=inner, dst_dir_fd=parent)
            os.fsync(parent)
    os.rmdir(waiting, dir_fd=parent)
