# SPDX-License-Identifier: Apache-2.0
"""Access files inside a folder only: neither ``..`` nor a symbolic link leads outside, and reads are bounded."""

from __future__ import annotations

import errno
import os
import posixpath
import stat
from pathlib import Path

from comarmor.errors import ComArmorError, Origin
from comarmor.text import did_you_mean, quoted
from comarmor.values import dataclass

FOLLOW_LINKS = "--trust-links follows it, e.g. in what 'colcon build --symlink-install' made"
"""What to do about a link that leads out of a package."""


@dataclass(frozen=True, slots=True)
class SandboxedFolder:
    """A folder that file access is confined to.

    Attributes:
        real: its resolved path.
        shown: the path as the user would type it.
        package: name of the package that ships it; empty for a folder of the policy's owner.
        path: its path, if ``shown`` is none.
        trusts_links: its symbolic links may lead anywhere.
        absent_is_empty: a file that it does not have counts as an empty one.
    """

    real: Path
    shown: str
    package: str = ""
    path: Path | None = None
    trusts_links: bool = False
    absent_is_empty: bool = False

    def name(self, relative: str) -> str:
        """Return the path of a file in this folder as the user would type it."""
        return path_text(relative if self.shown == "." else posixpath.join(self.shown, relative))

    def place(self, relative: str) -> Path:
        """Return the path of a file in this folder, before links are resolved."""
        return Path(self.path or self.shown, relative)


def resolve(folder: SandboxedFolder, relative: str, where: Origin) -> Path:
    """Return the resolved path of a file in a folder, whether or not it exists.

    Raises:
        ComArmorError: the path leads outside of the folder, also by ``..`` or a symbolic link.
    """
    outside = relative.split("/", 1)[0] == ".."
    try:
        real = (folder.real / relative).resolve()
    except (OSError, RuntimeError, ValueError) as error:
        raise ComArmorError(read_failure(error, "the file"), where=where, code="unreadable") from None
    if outside or not (folder.trusts_links or real.is_relative_to(folder.real)):
        raise ComArmorError(
            f"{quoted(relative, 200)} is outside of the policy's folder {quoted(path_text(folder.shown), 200)}",
            where=where,
            help=FOLLOW_LINKS
            if folder.package and not outside
            else "copy the file into the folder, and include the copy",
            code="include-outside",
        )
    return real


def read_in(folder: SandboxedFolder, real: Path, size: int, where: Origin) -> bytes:
    """Return at most ``size`` bytes of a file that :func:`resolve` returned for a folder; see :func:`read_bounded`.

    Raises:
        ComArmorError: it cannot be read.
    """
    try:
        return read_bounded(real.parent if folder.trusts_links else folder.real, real, size)
    except (OSError, ValueError) as error:
        raise ComArmorError(read_failure(error, "the file"), where=where, code="unreadable") from None


def exists(folder: SandboxedFolder, relative: str, where: Origin) -> bool:
    """Whether a path in a folder exists.

    Raises:
        ComArmorError: the path leads outside of the folder, or cannot be accessed.
    """
    try:
        resolve(folder, relative, where).lstat()
    except (FileNotFoundError, NotADirectoryError):
        return False
    except OSError as error:
        raise ComArmorError(read_failure(error, "the file"), where=where, code="unreadable") from None
    return True


def read_bounded(folder: Path, real: Path, size: int) -> bytes:
    """Return at most ``size`` bytes of a regular file below a folder.

    Each folder of the path is opened relative to the previous one, and none may be a symbolic link. So a path that was
    resolved and checked cannot be swapped for one that leads outside.
    """
    *folders, last = real.relative_to(folder).parts
    here = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        for part in folders:
            inner = os.open(part, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC, dir_fd=here)
            os.close(here)
            here = inner
        # Without O_NONBLOCK, opening a named pipe would block.
        file = os.open(last, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC, dir_fd=here)
    finally:
        os.close(here)
    try:
        with os.fdopen(file, "rb", closefd=False) as stream:  # it raises an error for a folder, and leaves it open
            if not stat.S_ISREG(os.fstat(file).st_mode):
                raise OSError(errno.EINVAL, "it is not a regular file")
            return stream.read(size)
    finally:
        os.close(file)


def similar_file(folder: SandboxedFolder, relative: str, including: str = "") -> str:
    """Return a hint at a file with a similar name in the folder of a missing file.

    Args:
        folder: the sandbox.
        relative: path of the missing file.
        including: the including file as messages name it; it is not suggested.
    """
    parent, missing = posixpath.split(relative)
    try:
        names = [entry.name for entry in (folder.real / parent).iterdir()]
    except OSError:
        return ""
    names = [name for name in names if folder.name(posixpath.join(parent, name)) != including]
    return did_you_mean(missing, names)


def read_failure(error: Exception, what: str) -> str:
    """Return a message why a file or folder cannot be read."""
    if isinstance(error, FileNotFoundError):
        return f"{what} does not exist"
    reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    return f"{what} cannot be read: {reason}"


def path_text(path: str) -> str:
    """Return a path as UTF-8 text; bytes that are not UTF-8 are escaped."""
    return path.encode("utf-8", "surrogateescape").decode("utf-8", "backslashreplace")
