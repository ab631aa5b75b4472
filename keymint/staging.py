"""Stages a folder beside the one that it is to replace: what changes is written, all else is carried along.

A folder of an enclave may hold the folders of others, and files that Keymint knows nothing of. Files are carried along
as hard links: they stay the same files, with their bytes, owners, modes and attributes, and cost no copy. Folders are
made again with the mode, owner and attributes (access-control lists) that they have.
"""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
import stat
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import NoReturn

from comarmor.errors import Origin
from keymint.errors import KeymintError
from keymint.writing import FOLDER, NEW_FILE, WritableFile, create, give, is_temporary, reported, require_regular

_NO_LINK = {errno.EPERM, errno.EMLINK, errno.EOPNOTSUPP, errno.ENOSYS}
"""What a system says that makes no hard link: the file system has none, or the file is another user's."""


@dataclass(slots=True)
class Content:
    """What becomes of a folder, and of the folders in it.

    Attributes:
        files: files to write, by name.
        removed: names of files to remove.
        mode: mode of the folder if it is new; an old one keeps its mode.
        private: close the folder (0700) if it is open to others.
        folders: what becomes of folders in it that change, by name.
    """

    files: dict[str, WritableFile] = field(default_factory=dict)
    removed: set[str] = field(default_factory=set)
    mode: int = 0o755
    private: bool = False
    folders: dict[str, Content] = field(default_factory=dict)

    def writes(self) -> bool:
        """Tell whether a file is written here or below."""
        return bool(self.files) or any(inner.writes() for inner in self.folders.values())

    def removes(self) -> bool:
        """Tell whether a file is removed here or below."""
        return bool(self.removed) or any(inner.removes() for inner in self.folders.values())


@dataclass(slots=True)
class Carried:
    """What was carried along: files with their inodes, folders with what was carried of them; and what was not."""

    files: dict[str, int] = field(default_factory=dict)
    folders: dict[str, Carried] = field(default_factory=dict)
    left: set[str] = field(default_factory=set)


@contextlib.contextmanager
def _opened(parent: int, name: str) -> Iterator[int]:
    descriptor = os.open(name, FOLDER, dir_fd=parent)
    try:
        yield descriptor
    finally:
        os.close(descriptor)


def stage(old: int, new_parent: int, name: str, shown: Path, content: Content) -> Carried | None:
    """Make the folder that another one is to become, and synchronise it.

    Args:
        old: the open folder that is there.
        new_parent: the open folder to make the new one in.
        name: name of the new one.
        shown: path of the folder that is there, for messages.
        content: what becomes of it.

    Returns:
        What was carried along; None when nothing is left in the folder. Then it is not made.

    Raises:
        KeymintError: the system refuses, a link or something else stands in the way, or a file system is mounted
            inside the folder. What was made so far is left for the caller to remove.
    """
    with reported(shown):
        status = os.fstat(old)
        if not os.access(".", os.W_OK | os.X_OK, dir_fd=old, effective_ids=True):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
        os.mkdir(name, 0o700, dir_fd=new_parent)
        with _opened(new_parent, name) as new:
            give(new, (status.st_uid, status.st_gid))
            _copy_attributes(old, new)
            carried = _carry(old, new, shown, content)
            for file in content.files:
                replaced = require_regular(old, shown, file) or status
                create(new, shown, file, content.files[file], (replaced.st_uid, replaced.st_gid))
            _add_folders(new, shown, content)
            if content.removes() and not (carried.files or carried.folders or content.writes()):
                os.rmdir(name, dir_fd=new_parent)
                return None
            mode = stat.S_IMODE(status.st_mode)
            os.fchmod(new, 0o700 if content.private and mode & 0o077 else mode)
            os.fsync(new)
    return carried


def _carry(old: int, new: int, shown: Path, content: Content) -> Carried:
    """Carry along what does not change, and the folders inside with what changes there."""
    carried = Carried(left={*content.files, *content.removed})
    mount = mount_of(old)
    with os.scandir(old) as entries:
        found = sorted(entries, key=lambda entry: entry.name)
    for entry in found:
        name = entry.name
        if is_temporary(name):
            carried.left.add(name)
        elif entry.is_dir(follow_symlinks=False):
            if name in content.removed:
                raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
            with _opened(old, name) as inner:
                if mount_of(inner) != mount:
                    refuse_mount(shown / name)
                below = stage(inner, new, name, shown / name, content.folders.get(name, Content()))
            if below is None:
                carried.left.add(name)
            else:
                carried.folders[name] = below
        elif name not in carried.left:
            _link(old, new, shown / name, name)
            carried.files[name] = entry.inode()
    return carried


def _add_folders(parent: int, shown: Path, content: Content) -> None:
    """Make the folders that are new in a staged one."""
    for name, inner in content.folders.items():
        if inner.writes() and not _exists(parent, name):
            add(parent, name, shown / name, inner)


def add(parent: int, name: str, shown: Path, content: Content) -> None:
    """Make a new folder, and synchronise it.

    Args:
        parent: the open folder to make it in.
        name: its name there.
        shown: its path, for messages.
        content: its files and folders.

    Raises:
        KeymintError: the system refuses. What was made so far is left for the caller to remove.
    """
    with reported(shown):
        os.mkdir(name, 0o700, dir_fd=parent)
        with _opened(parent, name) as new:
            for file in content.files:
                create(new, shown, file, content.files[file])
            _add_folders(new, shown, content)
            os.fchmod(new, 0o700 if content.private else content.mode)
            os.fsync(new)


def _exists(parent: int, name: str) -> bool:
    try:
        os.stat(name, dir_fd=parent, follow_symlinks=False)
    except FileNotFoundError:
        return False
    return True


def _link(old: int, new: int, shown: Path, name: str) -> None:
    with reported(shown):
        try:
            os.link(name, name, src_dir_fd=old, dst_dir_fd=new, follow_symlinks=False)
        except OSError as error:
            if error.errno == errno.EXDEV:
                refuse_mount(shown)
            if error.errno not in _NO_LINK:
                raise
            _copy(old, new, shown, name)


def _copy(old: int, new: int, shown: Path, name: str) -> None:
    """Copy a file where no hard link can be made, e.g. on FAT."""
    status = os.stat(name, dir_fd=old, follow_symlinks=False)
    if stat.S_ISLNK(status.st_mode):
        os.symlink(os.readlink(name, dir_fd=old), name, dir_fd=new)
        return
    if not stat.S_ISREG(status.st_mode):
        raise KeymintError(
            "is not a regular file, and cannot be carried along when its folder is replaced",
            where=Origin(str(shown)), help="remove it, or keep it elsewhere", code="carry-refused",
        )  # fmt: skip
    source = os.open(name, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC, dir_fd=old)
    target = os.open(name, NEW_FILE, 0o600, dir_fd=new)
    try:
        while chunk := os.read(source, 1 << 20):
            view = memoryview(chunk)
            while view:
                view = view[os.write(target, view) :]
        give(target, (status.st_uid, status.st_gid))
        made = os.fstat(target)
        if (made.st_uid, made.st_gid) != (status.st_uid, status.st_gid):
            raise KeymintError(
                f"belongs to user {status.st_uid} and group {status.st_gid}, and cannot be carried along",
                where=Origin(str(shown)), help="run as that user or as root, or change its owner", code="carry-refused",
            )  # fmt: skip
        _copy_attributes(source, target)
        os.fchmod(target, stat.S_IMODE(status.st_mode))
        os.utime(target, ns=(status.st_atime_ns, status.st_mtime_ns))
        os.fsync(target)
    finally:
        os.close(source)
        os.close(target)


def _copy_attributes(old: int, new: int) -> None:
    """Copy extended attributes, such as access-control lists, as far as the system lets us."""
    with contextlib.suppress(OSError):
        names = set(os.listxattr(old))
        for name in set(os.listxattr(new)) - names:
            with contextlib.suppress(OSError):
                os.removexattr(new, name)
        for name in names:
            with contextlib.suppress(OSError):
                os.setxattr(new, name, os.getxattr(old, name))


def mount_of(opened: int) -> str:
    """Return what tells the mount of an open folder from others: one file system may be mounted at several places."""
    with contextlib.suppress(OSError), open(f"/proc/self/fdinfo/{opened}", encoding="ascii") as info:  # noqa: PTH123
        for line in info:
            if line.startswith("mnt_id:"):
                return line
    return str(os.fstat(opened).st_dev)


def refuse_mount(shown: Path) -> NoReturn:
    """Raise the error for a folder that cannot be replaced, as something is mounted there."""
    raise KeymintError(
        "is a mount point, which cannot be replaced as a whole",
        where=Origin(str(shown)),
        help="unmount it; mount the folder above the enclaves instead",
        code="mount-refused",
    )


def clear(parent: int, name: str, new: int, carried: Carried) -> None:
    """Remove the folder that was replaced.

    What somebody else put into it after it was carried along is moved to the new folder.

    Args:
        parent: the open folder that it lies in.
        name: its name there.
        new: the open folder that took its place.
        carried: what was carried along.

    Raises:
        OSError: the system refuses.
    """
    with _opened(parent, name) as old:
        with os.scandir(old) as entries:
            found = sorted(entries, key=lambda entry: entry.name)
        for entry in found:
            below = carried.folders.get(entry.name)
            if below is not None:
                with _opened(new, entry.name) as inner:
                    clear(old, entry.name, inner, below)
            elif entry.name in carried.left and entry.is_dir(follow_symlinks=False):
                shutil.rmtree(entry.name, dir_fd=old)
            elif entry.name in carried.left or carried.files.get(entry.name) == entry.inode():
                os.unlink(entry.name, dir_fd=old)
            else:
                os.rename(entry.name, entry.name, src_dir_fd=old, dst_dir_fd=new)
                with contextlib.suppress(FileNotFoundError):  # two names of one file: then nothing was renamed
                    os.unlink(entry.name, dir_fd=old)
    os.rmdir(name, dir_fd=parent)
