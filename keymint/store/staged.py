# SPDX-License-Identifier: Apache-2.0
"""Write changes beside their places; nothing is visible until :mod:`~keymint.store.group_commit` exchanges the names.

What changes in one folder appears in one step, and with it the changes in its subfolders: a new folder is staged whole,
and so is the replacement of a folder in which several files change.

The folder of an enclave may contain the folders of other enclaves, and files that Keymint does not know. In the
replacement of a folder, files are carried over as hard links: they keep their inode, bytes, owner, mode and attributes,
and nothing is copied. Folders are created again with the same mode, owner and attributes (access-control lists).
"""

from __future__ import annotations

import contextlib
import errno
import os
import stat
from collections.abc import Iterable, Iterator, Mapping
from importlib import import_module
from typing import Any, NoReturn

from comarmor.values import Data, field
from keymint.store import file_writing
from keymint.store.changes import File, FolderChange
from keymint.store.file_writing import FILE, FOLDER, NEW_FILE, open_at, reported, temporary
from keymint.store.open_folders import OpenFolders, Roots, close_to_others
from keymint.view.file_reading import file_error, is_temporary
from keymint.view.recorded_answers import FolderStatus, new_status

_NO_LINK = {errno.EPERM, errno.EMLINK, errno.EOPNOTSUPP, errno.ENOSYS}
"""Errors where no hard link can be made: the file system has none, or the file belongs to another user."""
NOT_EMPTY = {errno.EEXIST, errno.ENOTEMPTY}
"""Errors of renaming onto a folder that is not empty, or of removing it (POSIX allows either)."""


class Exchange(Data):
    """A name that changes.

    Attributes:
        order: number of the change that it belongs to.
        folder: the folder with the name.
        name: the name of a file or folder.
        staged: the name, in the same folder, of what was staged for it; None if the name is removed.
        file: it is the name of a file.
        replaces: it is the name of a folder that is replaced or removed.
        changed: the files that change in that folder and below it, each with its new digest, or None if it is removed.
        carried: the inode of each file in that folder or below it that its replacement has as well, by its path.
        size: number of files that were written for it.
    """

    order: int
    folder: str
    name: str
    staged: str | None
    file: bool = False
    replaces: bool = False
    changed: Mapping[str, str | None] = field(default_factory=dict)
    carried: dict[str, int] = field(default_factory=dict)
    size: int = 0


class FolderContent(Data, frozen=False):
    """The new content of a folder and its subfolders.

    Attributes:
        files: files to write, by name.
        removed: names of files to remove.
        mode: mode of a new folder; an existing one keeps its mode.
        private: set the folder's mode to 0700 if others can enter it.
        folders: new content of the subfolders that change, by name.
        order: number of the first change here or below.
        own: number of the last change here.
    """

    files: Mapping[str, File] = field(default_factory=dict)
    removed: set[str] = field(default_factory=set)
    mode: int = 0o755
    private: bool = False
    folders: dict[str, FolderContent] = field(default_factory=dict)
    order: int = 0
    own: int = 0

    def size(self) -> int:
        """Return the number of files that are written here or below."""
        return len(self.files) + sum(map(FolderContent.size, self.folders.values()))

    def writes(self) -> bool:
        """Tell whether a file is written here or below."""
        return bool(self.files) or any(map(FolderContent.writes, self.folders.values()))

    def removes(self) -> bool:
        """Tell whether a file is removed here or below."""
        return bool(self.removed) or any(map(FolderContent.removes, self.folders.values()))

    def changed(self, inside: str = "") -> Iterator[tuple[str, str | None]]:
        """Yield the path of each file that changes here or below, with its new digest, or None if it is removed."""
        yield from ((f"{inside}{name}", file.digest) for name, file in self.files.items())
        yield from ((f"{inside}{name}", None) for name in sorted(self.removed))
        for name, inner in self.folders.items():
            yield from inner.changed(f"{inside}{name}/")


class Staging:
    """Stages changes below roots.

    Args:
        roots: where it may write.
        seen: receives the status of new folders, by the path that each will have.
    """

    def __init__(self, roots: Roots, seen: dict[str, FolderStatus]) -> None:
        self._roots = roots
        self._seen = seen
        self._trees: dict[str, FolderContent] = {}
        self._kept: list[tuple[int, str, FolderChange, bool]] = []
        """Changes in folders that are never replaced, each with its number, folder, and whether that is private."""
        self._exchanges: list[Exchange] = []

    def stage(self, changes: Iterable[FolderChange]) -> tuple[Exchange, ...]:
        """Return the names that staged changes exchange, in order; all are checked before the first one is staged.

        Raises:
            KeymintError: a path is not below a root, a symbolic link is in the way, or the system refuses. Then nothing
                is left behind.
        """
        for order, change in enumerate(changes):
            self._add(order, change)
        with OpenFolders(self._roots) as folders:
            try:
                for root, tree in self._trees.items():
                    if root in self._roots.common:
                        self._fill(folders.open(os.path.dirname(root)), root, tree)
                    # What is only removed creates no root.
                    elif tree.writes() or os.path.lexists(root):
                        self._inside(folders.open(root), root, tree)
                for order, folder, change, private in self._kept:
                    if change.files or os.path.lexists(folder):
                        opened = folders.open(folder, private=private and bool(change.files))
                        for name in (*change.files, *change.removed):
                            self._file(order, opened, folder, name, change.files.get(name))
            except BaseException:
                remove_staged(self._exchanges, folders)
                raise
        return tuple(sorted(self._exchanges, key=lambda each: each.order))

    # -- what changes --------------------------------------------------------------------------------------------

    def _add(self, order: int, change: FolderChange) -> None:
        folder = str(change.folder)
        for name in (*change.files, *change.removed):
            file_writing.check_component(name, folder)
        if not change.files and not change.removed:
            return
        root = self._roots.of(folder)
        closed = self._roots.private[root]
        private = closed or change.private or any(file.secret for file in change.files.values())
        if folder in self._roots.kept and folder not in self._roots.common:
            self._kept.append((order, folder, change, private))
            return
        content = self._trees.setdefault(root, FolderContent())
        for part in folder[len(root) + 1 :].split("/") if folder != root else ():
            inner = content.folders.get(part)
            if inner is None:
                file_writing.check_component(part, folder)
                inner = content.folders[part] = FolderContent(mode=0o700 if closed else 0o755, order=order)
            content = inner
        content.own = order
        content.removed.difference_update(change.files)
        content.files = {**content.files, **change.files} if content.files else change.files
        if change.removed:
            content.files = {name: file for name, file in content.files.items() if name not in change.removed}
            content.removed.update(change.removed)
        content.private = content.private or private

    # -- how it is staged ----------------------------------------------------------------------------------------

    def _inside(self, opened: int, shown: str, content: FolderContent) -> None:
        """Stage the changes in the subfolders of an existing folder that is not replaced."""
        for name, inner in content.folders.items():
            place = f"{shown}/{name}"
            if place in self._roots.common:
                self._fill(opened, place, inner)
                continue
            try:
                old = os.open(name, FOLDER, dir_fd=opened)
            except FileNotFoundError:
                if written := inner.size():
                    with self._staging(opened, Exchange(inner.order, shown, name, temporary(), size=written)) as staged:
                        self._create(opened, staged, place, inner)
                    if inner.files:  # it gets another time with its name
                        self._seen.pop(place, None)
                continue
            except OSError as error:
                file_writing.refuse(place, error)
            try:
                self._existing(opened, shown, name, old, inner)
            finally:
                os.close(old)

    def _existing(self, parent: int, around: str, name: str, old: int, content: FolderContent) -> None:
        shown = f"{around}/{name}"
        with reported(shown):
            if content.removes():
                if not content.writes() and _is_emptied(old, content):
                    gone = dict(content.changed())
                    self._exchanges.append(Exchange(content.order, around, name, None, replaces=True, changed=gone))
                    return
                content.removed.intersection_update(os.listdir(old))
            changing = {*content.files, *content.removed}
            if len(changing) > 1:
                if file_writing.mount_of(old) != file_writing.mount_of(parent):
                    refuse_mount(shown)
                exchange = Exchange(
                    content.order, around, name, temporary(),
                    replaces=True, changed=dict(content.changed()), size=len(changing),
                )  # fmt: skip
                with self._staging(parent, exchange) as staged:
                    exchange.carried.update(self._replace(old, parent, staged, shown, content))
                return
            if content.private:
                close_to_others(old)
        for file in changing:
            self._file(content.own, old, shown, file, content.files.get(file))
        self._inside(old, shown, content)

    def _file(self, order: int, folder: int, shown: str, name: str, file: File | None) -> None:
        """Stage one file of an existing folder."""
        if file is None:
            self._exchanges.append(Exchange(order, shown, name, None, file=True))
            return
        replaced = file_writing.require_regular(folder, shown, name, or_link=file.replaces_link) or os.fstat(folder)
        with self._staging(folder, Exchange(order, shown, name, temporary(), file=True, size=1)) as staged:
            file_writing.create(folder, shown, staged, file, (replaced.st_uid, replaced.st_gid))

    @contextlib.contextmanager
    def _staging(self, folder: int, exchange: Exchange) -> Iterator[str]:
        """Yield the temporary name of what is staged for an exchange; it is removed again after an error."""
        staged = str(exchange.staged)
        try:
            yield staged
        except BaseException:
            remove(folder, staged)
            raise
        self._exchanges.append(exchange)

    # -- folders that are new --------------------------------------------------------------------------------------

    def _replace(self, old: int, new_parent: int, name: str, shown: str, content: FolderContent) -> dict[str, int]:
        """Create the replacement of a folder, unless it would be empty.

        Args:
            old: the existing folder, open.
            new_parent: the open folder in which to create the replacement.
            name: name of the replacement.
            shown: path of the existing folder, for messages.
            content: its new content.

        Returns:
            The inode of each file that is carried over, by its path.

        Raises:
            KeymintError: the system refuses, a link or another kind of file is in the way, or a file system is mounted
                inside the folder. The caller must remove what was created so far.
        """
        with reported(shown):
            status = os.fstat(old)
            if not os.access(".", os.W_OK | os.X_OK, dir_fd=old, effective_ids=True):
                raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
            os.mkdir(name, 0o700, dir_fd=new_parent)
            with open_at(name, new_parent) as new:
                file_writing.give(new, (status.st_uid, status.st_gid))
                _copy_attributes(old, new)
                carried = self._carry(old, new, shown, content)
                for file, changed in content.files.items():
                    replaced = file_writing.require_regular(old, shown, file, or_link=changed.replaces_link) or status
                    file_writing.create(new, shown, file, changed, (replaced.st_uid, replaced.st_gid))
                there = {each.name for each in os.scandir(new) if each.is_dir()}
                for inner, below in content.folders.items():
                    if below.writes() and inner not in there:
                        self._create(new, inner, f"{shown}/{inner}", below)
                if content.removes() and not list(os.scandir(new)):
                    os.rmdir(name, dir_fd=new_parent)
                else:
                    mode = stat.S_IMODE(status.st_mode)
                    os.fchmod(new, 0o700 if content.private and mode & 0o077 else mode)
            return carried

    def _carry(self, old: int, new: int, shown: str, content: FolderContent) -> dict[str, int]:
        """Carry over the entries that do not change, and stage the subfolders; returns what :meth:`_replace` does."""
        carried: dict[str, int] = {}
        mount = file_writing.mount_of(old)
        for entry in sorted(os.scandir(old), key=lambda entry: entry.name):
            name = entry.name
            if is_temporary(name):
                continue
            if entry.is_dir(follow_symlinks=False):
                if name in content.removed:
                    raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
                with open_at(name, old) as inner:
                    if file_writing.mount_of(inner) != mount:
                        refuse_mount(f"{shown}/{name}")
                    below = content.folders.get(name, FolderContent())
                    inside = self._replace(inner, new, name, f"{shown}/{name}", below)
                carried |= {f"{name}/{path}": inode for path, inode in inside.items()}
            elif name not in content.files and name not in content.removed:
                _link(old, new, f"{shown}/{name}", name)
                carried[name] = entry.inode()
        return carried

    def _fill(self, parent: int, shown: str, content: FolderContent) -> None:
        """Stage what is inside a new folder in which other processes stage, too; arguments as for :meth:`_create`."""
        with reported(shown), open_at(self._roots.common[shown], parent) as opened:
            if content.private:
                close_to_others(opened)
            for name, file in content.files.items():
                file_writing.create(opened, shown, name, file)
            for name, inner in content.folders.items():
                place = f"{shown}/{name}"
                if place in self._roots.common:
                    self._fill(opened, place, inner)
                elif inner.writes():
                    self._create(opened, name, place, inner)

    def _create(self, parent: int, name: str, shown: str, content: FolderContent) -> None:
        """Create a new folder.

        The status of it and of each folder below it that has either files or folders, and no links, is noted.

        Args:
            parent: the open folder in which to create it.
            name: its name.
            shown: the path that it will have.
            content: its files and folders.

        Raises:
            KeymintError: the system refuses. The caller must remove what was created so far.
        """
        mode = 0o700 if content.private else content.mode
        with reported(shown):
            os.mkdir(name, mode, dir_fd=parent)
            new = os.open(name, FOLDER, dir_fd=parent)
            try:
                files = {inner: file_writing.create(new, shown, inner, file) for inner, file in content.files.items()}
                for inner, below in content.folders.items():
                    if below.writes():
                        self._create(new, inner, f"{shown}/{inner}", below)
                status = new_status(file_writing.with_mode(new, mode), files, content.folders)
                if status is not None and not (files and content.folders):
                    self._seen[shown] = status
            finally:
                os.close(new)


def _is_emptied(old: int, content: FolderContent) -> bool:
    """Tell whether nothing would be left in a folder."""
    for entry in list(os.scandir(old)):
        if not entry.is_dir(follow_symlinks=False):
            if entry.name not in content.removed:
                return False
            continue
        if entry.name not in content.folders:
            return False
        with open_at(entry.name, old) as opened:
            if not _is_emptied(opened, content.folders[entry.name]):
                return False
    return True


def remove_staged(exchanges: Iterable[Exchange], folders: OpenFolders) -> None:
    """Remove what was staged, as far as it is still there."""
    for exchange in exchanges:
        if exchange.staged is not None:
            remove(folders.open(exchange.folder), exchange.staged)


def remove(folder: int, name: str) -> None:
    """Remove a file or folder, as far as the system permits it."""
    try:
        os.unlink(name, dir_fd=folder)
    except OSError:
        rmtree(name, ignore_errors=True, dir_fd=folder)


def rmtree(folder: str, **how: Any) -> None:
    """Remove a folder with all in it, by :func:`shutil.rmtree`; few runs need that module."""
    import_module("shutil").rmtree(folder, **how)


def _link(old: int, new: int, shown: str, name: str) -> None:
    with reported(shown):
        try:
            os.link(name, name, src_dir_fd=old, dst_dir_fd=new, follow_symlinks=False)
        except OSError as error:
            if error.errno == errno.EXDEV:
                refuse_mount(shown)
            if error.errno not in _NO_LINK:
                raise
            _copy(old, new, shown, name)


def _copy(old: int, new: int, shown: str, name: str) -> None:
    """Copy a file if no hard link can be made, e.g. on FAT."""
    status = os.stat(name, dir_fd=old, follow_symlinks=False)
    if stat.S_ISLNK(status.st_mode):
        os.symlink(os.readlink(name, dir_fd=old), name, dir_fd=new)
        return
    if not stat.S_ISREG(status.st_mode):
        message = "is not a regular file, and cannot be kept when its folder is replaced"
        raise file_error(shown, "carry-refused", message, "remove it, or move it elsewhere")
    with open_at(name, old, FILE) as source, open_at(name, new, NEW_FILE) as target:
        while chunk := os.read(source, 1 << 20):
            file_writing.write_all(target, chunk)
        file_writing.give(target, (status.st_uid, status.st_gid))
        made = os.fstat(target)
        if (made.st_uid, made.st_gid) != (status.st_uid, status.st_gid):
            owner = f"user {status.st_uid} and group {status.st_gid}"
            message = f"belongs to {owner}, and cannot be kept in a new folder"
            raise file_error(shown, "carry-refused", message, "run as that user or as root, or change its owner")
        _copy_attributes(source, target)
        os.fchmod(target, stat.S_IMODE(status.st_mode))
        os.utime(target, ns=(status.st_atime_ns, status.st_mtime_ns))


def _copy_attributes(old: int, new: int) -> None:
    """Copy extended attributes, such as access-control lists, where the system permits that."""
    with contextlib.suppress(OSError):
        names = set(os.listxattr(old))
        for name in set(os.listxattr(new)) - names:
            with contextlib.suppress(OSError):
                os.removexattr(new, name)
        for name in names:
            with contextlib.suppress(OSError):
                os.setxattr(new, name, os.getxattr(old, name))


def refuse_mount(shown: str) -> NoReturn:
    """Raise the error for a folder that cannot be replaced because it is a mount point."""
    help_ = "unmount it; mount the folder above the enclaves instead"
    raise file_error(shown, "mount-refused", "is a mount point, which cannot be replaced", help_)
