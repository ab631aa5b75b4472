# SPDX-License-Identifier: Apache-2.0
"""The only writer: confined, locked, atomic, and strict about modes.

* Every path is walked from one of the store's roots without following a link, so nothing is written elsewhere.
* A file is written under a temporary name, synchronised, and renamed into place. A new folder appears complete.
* A folder in which several files change is staged under a temporary name and swapped in one step; see
  :mod:`keymint.folder_staging` and :mod:`keymint.folder_swap`.
* A secret is 0600 from its first byte and its folder 0700, whatever the umask.
* The next run removes what a killed run left behind.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import shutil
import stat
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path

from comarmor.errors import Origin
from keymint.changes import File, FolderChange
from keymint.errors import KeymintError
from keymint.file_writing import (
    FOLDER,
    check_component,
    create,
    is_temporary,
    make_folder,
    opened_folder,
    refuse,
    reported,
    require_regular,
    temporary,
)
from keymint.folder_staging import FolderContent, add, clear, mount_of, refuse_mount, stage
from keymint.folder_swap import finish, is_waiting, swap_in
from keymint.workspace_lock import LOCK, wait_for_lock

_EXISTS = {errno.EEXIST, errno.ENOTEMPTY}
"""Errors of a rename onto a folder that is not empty (POSIX allows either)."""


class Store:
    """Writes below its roots.

    Args:
        roots: absolute folders that may be written to, each with whether it is private: then every folder below
            it is 0700. Each is created when needed.
        records: folder of the lock, the mark of a running command, and the record; below one of the roots.
    """

    def __init__(self, roots: Mapping[Path, bool], records: Path) -> None:
        # Longest first: a path belongs to the innermost root.
        self._roots = dict(sorted(roots.items(), key=lambda item: len(item[0].parts), reverse=True))
        self._prefixes = {f"{root}/": root for root in self._roots}
        self._records = records
        self._mark = records / "running"

    # -- sessions ------------------------------------------------------------------------------------------------

    @contextlib.contextmanager
    def locked(self, on_wait: Callable[[], None]) -> Iterator[None]:
        """Hold the workspace lock exclusively.

        Args:
            on_wait: called once before waiting for another process that holds the lock.
        """
        with self._open_folder(self._records, private=False) as records:
            try:
                lock = os.open(LOCK, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o644, dir_fd=records)
            except OSError as error:
                refuse(self._records / LOCK, error)
        try:
            with reported(self._records / LOCK):
                wait_for_lock(lock, fcntl.LOCK_EX, on_wait)
            yield
        finally:
            os.close(lock)

    @contextlib.contextmanager
    def marked(self, content: bytes) -> Iterator[None]:
        """Mark a writing run as in progress; only a run that succeeds removes the mark.

        Args:
            content: what the next run must know if this one fails; see :func:`keymint.state.load`.
        """
        self.write(self._records, {self._mark.name: File(content)})
        yield
        with reported(self._mark), contextlib.suppress(FileNotFoundError):
            os.unlink(self._mark)

    def is_marked(self) -> bool:
        """Tell whether an earlier run did not finish."""
        return self._mark.exists()

    def sweep(self) -> None:
        """Remove the temporary files of a killed run, and finish its folder swaps."""
        # A run that is killed while it sets its mark leaves temporary files in the folder of records only.
        for root in self._roots if self.is_marked() else [self._records]:
            for folder, folders, files in os.walk(root):
                for name in filter(is_waiting, folders):
                    with reported(Path(folder) / name), opened_folder(folder) as parent:
                        finish(parent, name)
                for name in filter(is_temporary, (*folders, *files)):
                    path = Path(folder) / name
                    with reported(path):
                        if path.is_dir() and not path.is_symlink():
                            shutil.rmtree(path)
                        else:
                            path.unlink()
                folders[:] = (name for name in folders if not is_temporary(name) and not is_waiting(name))

    # -- writing -------------------------------------------------------------------------------------------------

    def change(self, changes: Iterable[FolderChange]) -> None:
        """Write and remove files; all changes in one folder take effect in one step.

        A folder that becomes empty is removed, and so are its parents below the root.

        A folder in which several files change is replaced, together with the changes in its subfolders. A root of the
        store is never replaced, because it may be a mount point.

        Args:
            changes: changes in this order; a folder may occur more than once.

        Raises:
            KeymintError: a path is not below a root, a symbolic link is in the way, or the system refuses.
        """
        merged = self._merged(changes)
        replaced = {folder for folder, change in merged.items() if self._is_replaced(folder, change)}
        units: dict[Path, dict[Path, FolderChange]] = {}
        for folder, change in merged.items():
            outermost = next((each for each in (*reversed(folder.parents), folder) if each in replaced), folder)
            units.setdefault(outermost, {})[folder] = change
        for outermost, inner in units.items():
            if outermost in replaced:
                self._replace_folder(outermost, self._content(outermost, inner))
            for folder, change in inner.items() if outermost not in replaced else ():
                self._write(folder, change)
                if change.removed:
                    self._remove(folder, change.removed)

    def write(self, folder: Path, files: Mapping[str, File], *, private: bool = False) -> None:
        """Write files into a folder, all in one step; see :meth:`change`."""
        self.change([FolderChange(folder, files, (), private)])

    def _merged(self, changes: Iterable[FolderChange]) -> dict[Path, FolderChange]:
        """Return one change for each folder in which anything changes."""
        merged: dict[Path, FolderChange] = {}
        for change in changes:
            folder, before = change.folder, merged.get(change.folder, FolderChange(change.folder, {}))
            for name in (*change.files, *change.removed):
                check_component(name, folder)
            root = self._root_of(folder) if change.files or change.removed else None
            if root is None:
                continue
            private = self._roots[root] or change.private or any(file.secret for file in change.files.values())
            files = {name: file for name, file in before.files.items() if name not in change.removed}
            removed = tuple(name for name in before.removed if name not in change.files) + change.removed
            merged[folder] = FolderChange(folder, {**files, **change.files}, removed, private or before.private)
        return {folder: merged[folder] for folder in self._outer_first(merged)}

    def _outer_first(self, folders: Iterable[Path]) -> Iterator[Path]:
        """Yield folders in order, but a new one before its subfolders, so that it appears complete."""
        known = dict.fromkeys(folders)
        for folder in known:
            for outer in (*reversed(folder.parents), folder):
                if outer in known and (outer == folder or not (self._stays(outer) or os.path.lexists(outer))):
                    yield outer

    def _is_replaced(self, folder: Path, change: FolderChange) -> bool:
        """Tell whether a folder is replaced; a single file is replaced in one step anyway."""
        several = len({*change.files, *change.removed}) > 1
        return several and not self._stays(folder) and os.path.lexists(folder)

    def _content(self, outermost: Path, changes: Mapping[Path, FolderChange]) -> FolderContent:
        """Return the new content of a folder, from the changes in it and in its subfolders."""
        mode = 0o700 if self._roots[self._root_of(outermost)] else 0o755
        content = FolderContent(mode=mode)
        for folder, change in changes.items():
            inner = content
            for part in folder.relative_to(outermost).parts:
                check_component(part, folder)
                inner = inner.folders.setdefault(part, FolderContent(mode=mode))
            inner.files, inner.removed, inner.private = dict(change.files), set(change.removed), change.private
        return content

    def _replace_folder(self, folder: Path, content: FolderContent) -> None:
        """Replace a folder, or remove it if nothing is left in it."""
        with self._open_folder(folder.parent, private=False) as parent, contextlib.ExitStack() as opened:
            staged: str | None = temporary()
            try:
                with reported(folder):
                    old = opened.enter_context(opened_folder(folder.name, parent))
                    if mount_of(old) != mount_of(parent):
                        refuse_mount(folder)
                    carried = stage(old, parent, str(staged), folder, content)
                    if carried is not None:
                        new = opened.enter_context(opened_folder(str(staged), parent))
                        staged = swap_in(parent, str(staged), folder.name)  # now the name of the old folder
                        if staged is not None:
                            clear(parent, staged, new, carried)
            except BaseException:
                # The temporary name belongs to the new folder before the swap and to the old one after it.
                shutil.rmtree(str(staged), ignore_errors=True, dir_fd=parent)
                raise
        if carried is None:
            self._remove_folder(folder)

    def _write(self, folder: Path, change: FolderChange) -> None:
        """Write files one by one, or all at once into a new folder."""
        if not change.files:
            return
        if folder not in self._roots and not os.path.lexists(folder) and self._write_new(folder, change):
            return
        with self._open_folder(folder, private=change.private) as opened:
            for name, file in change.files.items():
                self._replace(opened, folder, name, file)
            with reported(folder):
                os.fsync(opened)

    def _write_new(self, folder: Path, change: FolderChange) -> bool:
        """Write a new folder under a temporary name and rename it into place.

        Returns:
            False if another process created the folder in the meantime.
        """
        closed = self._roots[self._root_of(folder)]
        with self._open_folder(folder.parent, private=closed) as parent:
            staged = temporary()
            check_component(folder.name, folder.parent)
            try:
                add(parent, staged, folder, FolderContent(dict(change.files), private=change.private))
                with reported(folder):
                    try:
                        os.rename(staged, folder.name, src_dir_fd=parent, dst_dir_fd=parent)
                    except OSError as error:
                        if error.errno not in _EXISTS:
                            raise
                        shutil.rmtree(staged, dir_fd=parent)
                        return False
                    os.fsync(parent)
            except BaseException:
                # Only under its temporary name: an interrupt after the rename must not empty the folder.
                shutil.rmtree(staged, ignore_errors=True, dir_fd=parent)
                raise
        return True

    def _replace(self, folder: int, shown: Path, name: str, file: File) -> None:
        replaced = require_regular(folder, shown, name) or os.fstat(folder)
        staged = temporary()
        try:
            create(folder, shown, staged, file, (replaced.st_uid, replaced.st_gid))
            with reported(shown / name):
                os.rename(staged, name, src_dir_fd=folder, dst_dir_fd=folder)
        except BaseException:
            with contextlib.suppress(OSError):
                os.unlink(staged, dir_fd=folder)
            raise

    def _remove(self, folder: Path, names: Sequence[str]) -> None:
        """Remove files one by one, or the folder if it contains nothing else."""
        if not os.path.lexists(folder):
            return
        with self._open_folder(folder, private=False) as opened:
            with reported(folder):
                remove_folder = not self._stays(folder) and set(os.listdir(opened)) <= set(names)
            if not remove_folder:
                for name in names:
                    with reported(folder / name), contextlib.suppress(FileNotFoundError):
                        os.unlink(name, dir_fd=opened)
            with reported(folder):
                os.fsync(opened)
        if remove_folder:
            self._remove_folder(folder)

    def _stays(self, folder: Path) -> bool:
        """Tell whether a folder is kept even if it is empty."""
        return folder in self._roots or folder == self._records

    def _remove_folder(self, folder: Path) -> None:
        """Remove a folder and the parents that contain nothing else, by first renaming the outermost one."""
        outermost = folder
        with reported(folder):
            while not self._stays(outermost.parent) and os.listdir(outermost.parent) == [outermost.name]:
                outermost = outermost.parent
        with self._open_folder(outermost.parent, private=False) as parent, reported(folder):
            away: str = temporary()
            try:
                os.rename(outermost.name, away, src_dir_fd=parent, dst_dir_fd=parent)
            except OSError as error:
                if error.errno != errno.EXDEV:
                    raise
                away = outermost.name  # overlayfs cannot rename a folder of a lower layer: remove file by file
            os.fsync(parent)
            shutil.rmtree(away, dir_fd=parent)
        above = outermost.parent
        with contextlib.suppress(OSError):  # not empty: it stays
            while not self._stays(above):
                os.rmdir(above)
                above = above.parent

    # -- folders -------------------------------------------------------------------------------------------------

    def _root_of(self, path: Path) -> Path:
        text = f"{path}/"
        for prefix, root in self._prefixes.items():
            if text.startswith(prefix) and "/../" not in text:
                return root
        raise KeymintError("is outside the workspace", where=Origin(str(path)), code="confined")

    @contextlib.contextmanager
    def _open_folder(self, path: Path, *, private: bool) -> Iterator[int]:
        """Open a folder below a root, creating missing folders, without following symbolic links."""
        root = self._root_of(path)
        with reported(root):
            if not os.path.lexists(root):
                root.parent.mkdir(parents=True, exist_ok=True)
                with contextlib.suppress(FileExistsError):
                    make_folder(root, 0o700 if self._roots[root] else 0o755)
            opened = os.open(root, FOLDER)
        try:
            parts = path.relative_to(root).parts
            for depth, part in enumerate(parts):
                check_component(part, path)
                with reported(path):
                    last = depth == len(parts) - 1
                    inner = self._enter(opened, part, 0o700 if self._roots[root] or (private and last) else 0o755)
                os.close(opened)
                opened = inner
            if private and parts and stat.S_IMODE(os.fstat(opened).st_mode) & 0o077:
                with reported(path):
                    os.fchmod(opened, 0o700)
            yield opened
        finally:
            os.close(opened)

    @staticmethod
    def _enter(folder: int, name: str, mode: int) -> int:
        try:
            return os.open(name, FOLDER, dir_fd=folder)
        except FileNotFoundError:
            with contextlib.suppress(FileExistsError):
                make_folder(name, mode, folder)
            return os.open(name, FOLDER, dir_fd=folder)
