# SPDX-License-Identifier: Apache-2.0
"""Exchange two names in one step: Linux can (``renameat2`` with ``RENAME_EXCHANGE``; see renameat2(2)).

Some file systems cannot (NFS, some FUSE file systems), or not with each folder (overlayfs, for one in a lower layer:
``EXDEV``); see :data:`UNABLE`.
"""

from __future__ import annotations

import ctypes
import errno
import os

from keymint.store.file_writing import c_function

_EXCHANGE = 2  # RENAME_EXCHANGE of <linux/fs.h>
UNABLE = {errno.EINVAL, errno.ENOSYS, errno.EXDEV, errno.EOPNOTSUPP, errno.EPERM}
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
