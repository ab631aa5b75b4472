"""Primitives of the only writer: how one file or folder is made, and how an error of the system is reported.

Everything here works on names in a folder that is open already, so that no link is followed on the way.
"""

from __future__ import annotations

import contextlib
import errno
import itertools
import os
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import NoReturn, Protocol

from comarmor.errors import Origin
from comarmor.text import quoted
from keymint.errors import KeymintError

PREFIX, SUFFIX = ".keymint-", ".tmp"
"""Around the names of temporary files and folders."""
FOLDER = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC
NEW_FILE = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
MAX_COMPONENT = 255
"""Bytes of a path's component on the file systems in use."""
_serial = itertools.count()


class WritableFile(Protocol):
    """A file to write; see :class:`keymint.changes.File`."""

    @property
    def content(self) -> bytes:
        """The bytes."""

    @property
    def secret(self) -> bool:
        """Whether it is 0600 or 0644."""


def temporary(suffix: str = SUFFIX) -> str:
    """Return a name that no other file has, and that a sweep recognises."""
    return f"{PREFIX}{os.getpid()}-{next(_serial)}{suffix}"


def is_temporary(name: str) -> bool:
    """Tell whether a file or folder of this name may be removed once no run is under way."""
    return name.startswith(PREFIX) and name.endswith(SUFFIX)


def create(folder: int, shown: Path, name: str, file: WritableFile, owner: tuple[int, int] | None = None) -> None:
    """Create a file, and synchronise it.

    Args:
        folder: the open folder.
        shown: its path, for messages.
        name: the file's name, which no file has yet.
        file: its content.
        owner: user and group that it belongs to, as far as the system lets us give it away.
    """
    with reported(shown / name):
        opened = os.open(name, NEW_FILE, 0o600, dir_fd=folder)
        try:
            view = memoryview(file.content)
            while view:
                view = view[os.write(opened, view) :]
            give(opened, owner)
            os.fchmod(opened, 0o600 if file.secret else 0o644)
            os.fsync(opened)
        finally:
            os.close(opened)


def give(opened: int, owner: tuple[int, int] | None) -> None:
    """Give an open file or folder to a user and group; only root may, and for others it stays their own."""
    found = os.fstat(opened)
    if owner is not None and owner != (found.st_uid, found.st_gid):
        with contextlib.suppress(PermissionError):
            os.fchown(opened, *owner)


def make_folder(name: str | Path, mode: int, parent: int | None = None) -> None:
    """Make a folder with exactly this mode, whatever the umask."""
    os.mkdir(name, mode, dir_fd=parent)
    if stat.S_IMODE(os.stat(name, dir_fd=parent, follow_symlinks=False).st_mode) != mode:
        os.chmod(name, mode, dir_fd=parent)


def check_component(name: str, folder: Path) -> None:
    """Refuse what is not the name of a file."""
    if name in {"", ".", ".."} or "/" in name or "\0" in name:
        raise KeymintError(f"{name!r} is not the name of a file", where=Origin(str(folder)), code="confined")
    if len(os.fsencode(name)) > MAX_COMPONENT:
        raise KeymintError(
            f"the name {quoted(name, 40)} is longer than {MAX_COMPONENT} bytes",
            where=Origin(str(folder)),
            code="confined",
        )


def require_regular(folder: int, shown: Path, name: str) -> os.stat_result | None:
    """Return the status of the regular file that is about to be replaced, or None when there is none.

    Raises:
        KeymintError: a link, a folder or something else has the name.
    """
    try:
        found = os.lstat(name, dir_fd=folder)
    except FileNotFoundError:
        return None
    if not stat.S_ISREG(found.st_mode):
        what = "a symbolic link" if stat.S_ISLNK(found.st_mode) else "not a regular file"
        raise KeymintError(
            f"is {what}, and is not replaced",
            where=Origin(str(shown / name)),
            help="remove it if it is not yours",
            code="symlink-refused",
        )
    return found


@contextlib.contextmanager
def reported(path: Path) -> Iterator[None]:
    """Turn what the system refuses into one line for the user."""
    try:
        yield
    except KeymintError:
        raise
    except OSError as error:
        refuse(path, error)


def refuse(path: Path, error: OSError) -> NoReturn:
    """Raise the error for a path that the system does not let us write."""
    link = error.errno == errno.ELOOP or (error.errno == errno.ENOTDIR and path.is_symlink())
    if link or any(parent.is_symlink() for parent in (path, *path.parents) if error.errno == errno.ENOTDIR):
        raise KeymintError(
            "a symbolic link stands in the way, which is refused",
            where=Origin(str(path)),
            help="remove it, or name the space by its option",
            code="symlink-refused",
        ) from error
    helps = {
        errno.ENOSPC: "free some space and run again; what was there before is intact",
        errno.EDQUOT: "free some space and run again; what was there before is intact",
        errno.EACCES: "check the owner and mode of the folder",
        errno.EPERM: "check the owner and mode of the folder",
        errno.EROFS: "the file system is mounted read-only",
    }
    raise KeymintError(
        f"cannot be written: {os.strerror(error.errno or 0)}",
        where=Origin(str(path)),
        help=helps.get(error.errno or 0, ""),
        code="write-failed",
    ) from error
