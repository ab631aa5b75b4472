# SPDX-License-Identifier: Apache-2.0
"""Read one file of a workspace, bounded; and where a symbolic link leads that stays in a folder."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path

from comarmor.values import Data
from keymint.errors import KeymintError, Origin

MAX_FILE = 16 * 1024 * 1024
"""Largest file that is read, in bytes; far more than any document, certificate or key."""
REGISTER = "register.sqlite3"
"""Name of the register of issued certificates, which has some hundred bytes for each."""
MAX_REGISTER = 64 * MAX_FILE
"""Largest register that is read, in bytes."""

PREFIX, SUFFIX = ".keymint-", ".tmp"
"""Prefix and suffix of the names of temporary files and folders of a run that writes."""


def is_temporary(name: str) -> bool:
    """Tell whether a file or folder of this name may be removed if no run is in progress."""
    return name.startswith(PREFIX) and name.endswith(SUFFIX)


def read_file(path: Path | str, most: int | None = None) -> bytes | None:
    """Return the bytes of a regular file, or None if there is none; arguments and errors as :func:`read_open_file`."""
    found = read_open_file(path, most)
    return found and found[0]


def read_open_file(path: Path | str, most: int | None = None) -> tuple[bytes, FileStatus] | None:
    """Return the bytes of a regular file, and its status; or None if there is none.

    Args:
        path: the file.
        most: largest size in bytes; by default :data:`MAX_REGISTER` for the register, else :data:`MAX_FILE`.

    Raises:
        KeymintError: the path is a symbolic link or no regular file, is too large, or cannot be read.
    """
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC | os.O_NONBLOCK)
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as error:
        if error.errno == errno.ELOOP:
            message = "is a symbolic link, which is refused here"
            raise file_error(path, "symlink-refused", message, "replace it by the file itself") from error
        raise read_error(path, error) from error
    try:
        status = os.fstat(descriptor)
        if not stat.S_ISREG(status.st_mode):
            raise file_error(path, "file-kind", "is not a regular file")
        if most is None:
            most = MAX_REGISTER if str(path).endswith(REGISTER) else MAX_FILE
        if status.st_size > most:
            raise file_error(path, "file-size", f"has {status.st_size} bytes, {most} are the most")
        chunks = [os.read(descriptor, status.st_size + 1)]
        while len(chunks[0]) != status.st_size and (chunk := os.read(descriptor, status.st_size + 1)):
            chunks.append(chunk)
        return b"".join(chunks), _status(status)
    except OSError as error:
        raise read_error(path, error) from error
    finally:
        os.close(descriptor)


def read_error(path: Path | str, error: OSError) -> KeymintError:
    """Return the error for a file that cannot be read."""
    message = f"cannot be read: {os.strerror(error.errno or 0)}"
    return file_error(path, "file-unreadable", message, "check its owner and mode")


def file_error(path: Path | str, code: str, message: str, help_: str = "") -> KeymintError:
    """Return an error about a file or folder.

    Args:
        path: its path.
        code: stable identifier in kebab-case.
        message: what is wrong with it.
        help_: how to fix it.
    """
    return KeymintError(message, where=Origin(str(path)), help=help_, code=code)


class FileStatus(Data):
    """What is asked of the status of a path: fields of :class:`os.stat_result`, which takes four times the memory."""

    st_mode: int
    st_uid: int
    st_gid: int
    st_nlink: int
    st_size: int
    st_ino: int


def lstat(path: str) -> FileStatus | None:
    """Return the status of a path without following a link, or None if it does not exist."""
    try:
        of = os.lstat(path)
    except (OSError, ValueError):
        return None
    return _status(of)


def _status(of: os.stat_result) -> FileStatus:
    return FileStatus(of.st_mode, of.st_uid, of.st_gid, of.st_nlink, of.st_size, of.st_ino)


def linked_file(path: str, folder: str) -> str:
    """Return the regular file that a relative symbolic link in a folder leads to, if that is in the folder; else empty.

    It must be readable by everyone: else a link could make the content of a private key look like a public file.

    Args:
        path: absolute path of the link.
        folder: absolute path of the folder; empty to follow no link.
    """
    if not folder or not path.startswith(f"{folder}/"):
        return ""
    try:
        relative = not os.readlink(path).startswith("/")  # noqa: PTH115 - of a text
        real = os.path.realpath(path, strict=True)
    except OSError:
        return ""
    status = lstat(real)
    inside = real.startswith(f"{os.path.realpath(folder)}/")
    public = status is not None and stat.S_ISREG(status.st_mode) and status.st_mode & stat.S_IROTH
    return real if relative and inside and public else ""
