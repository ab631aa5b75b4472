# SPDX-License-Identifier: Apache-2.0
"""Write changes beside their places; nothing is visible until :mod:`~keymint.store.group_commit` exchanges the names.

What changes in one folder appears in one step, and with it the changes in its subfolders: a new folder is staged whole,
and so is the replacement of a folder in which several files change.
"""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import field

from comarmor.values import dataclass
from keymint.store.changes import File, FolderChange
from keymint.store.file_writing import (
    FOLDER,
    check_component,
    create,
    mount_of,
    open_at,
    refuse,
    reported,
    require_regular,
    temporary,
)
from keymint.store.folder_staging import FolderContent, add, refuse_mount, stage
from keymint.store.open_folders import OpenFolders, Roots, close_to_others


@dataclass(frozen=True, slots=True)
class Exchange:
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
    carried: Mapping[str, int] = field(default_factory=dict)
    size: int = 0


class Staging:
    """Stages changes below roots.

    Args:
        roots: where it may write.
    """

    def __init__(self, roots: Roots) -> None:
        self._roots = roots
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
                    # What is only removed creates no root.
                    if tree.size() or os.path.lexists(root):
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
            check_component(name, folder)
        if not change.files and not change.removed:
            return
        root = self._roots.of(folder)
        closed = self._roots.private[root]
        private = closed or change.private or any(file.secret for file in change.files.values())
        if folder in self._roots.kept:
            self._kept.append((order, folder, change, private))
            return
        content = self._trees.setdefault(root, FolderContent())
        for part in folder[len(root) + 1 :].split("/"):
            inner = content.folders.get(part)
            if inner is None:
                check_component(part, folder)
                inner = content.folders[part] = FolderContent(mode=0o700 if closed else 0o755, order=order)
            content = inner
        content.own = order
        content.removed.difference_update(change.files)
        content.files.update(change.files)
        for name in change.removed:
            content.files.pop(name, None)
        content.removed.update(change.removed)
        content.private = content.private or private

    # -- how it is staged ----------------------------------------------------------------------------------------

    def _inside(self, opened: int, shown: str, content: FolderContent) -> None:
        """Stage the changes in the subfolders of an existing folder that is not replaced."""
        for name, inner in content.folders.items():
            try:
                old = os.open(name, FOLDER, dir_fd=opened)
            except FileNotFoundError:
                if written := inner.size():
                    with self._staging(opened, Exchange(inner.order, shown, name, temporary(), size=written)) as staged:
                        add(opened, staged, f"{shown}/{name}", inner)
                continue
            except OSError as error:
                refuse(f"{shown}/{name}", error)
            try:
                self._existing(opened, shown, name, old, inner)
            finally:
                os.close(old)

    def _existing(self, parent: int, around: str, name: str, old: int, content: FolderContent) -> None:
        shown = f"{around}/{name}"
        with reported(shown):
            if content.removes():
                if not content.size() and _is_emptied(old, content):
                    gone = dict(content.changed())
                    self._exchanges.append(Exchange(content.order, around, name, None, replaces=True, changed=gone))
                    return
                content.removed.intersection_update(os.listdir(old))
            changing = {*content.files, *content.removed}
            if len(changing) > 1:
                if mount_of(old) != mount_of(parent):
                    refuse_mount(shown)
                carried: dict[str, int] = {}
                exchange = Exchange(
                    content.order, around, name, temporary(),
                    replaces=True, changed=dict(content.changed()), carried=carried, size=len(changing),
                )  # fmt: skip
                with self._staging(parent, exchange) as staged:
                    stage(old, parent, staged, shown, content, carried)
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
        replaced = require_regular(folder, shown, name, or_link=file.replaces_link) or os.fstat(folder)
        with self._staging(folder, Exchange(order, shown, name, temporary(), file=True, size=1)) as staged:
            create(folder, shown, staged, file, (replaced.st_uid, replaced.st_gid))

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
        shutil.rmtree(name, ignore_errors=True, dir_fd=folder)
