"""The only writer: confined, locked, atomic, and strict about modes.

* Every path is walked from one of the store's roots without following a link, so nothing is written elsewhere.
* A file is written beside its place, synchronised, and renamed over it. A folder that is new appears whole.
* A folder in which several files change is staged beside its place, and takes it in one step; see
  :mod:`keymint.staging` and :mod:`keymint.exchange`.
* A secret is 0600 from its first byte and its folder 0700, whatever the umask.
* What a killed run left behind is swept away by the next.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import shutil
import stat
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from comarmor.errors import Origin
from keymint.errors import KeymintError
from keymint.exchange import finish, is_waiting, take_place
from keymint.staging import Content, add, clear, mount_of, refuse_mount, stage
from keymint.writing import (
    FOLDER,
    MAX_COMPONENT,
    WritableFile,
    check_component,
    create,
    is_temporary,
    make_folder,
    refuse,
    reported,
    require_regular,
    temporary,
)

__all__ = ["MAX_COMPONENT", "Store", "WritableFile", "WritableFolder"]


class WritableFolder(Protocol):
    """Files to write into a folder and names to remove from it; see :class:`keymint.changes.FolderChange`."""

    @property
    def folder(self) -> Path:
        """Absolute path."""

    @property
    def files(self) -> Mapping[str, WritableFile]:
        """Files by name."""

    @property
    def removed(self) -> Sequence[str]:
        """Names of files to remove."""

    @property
    def private(self) -> bool:
        """Folders that are created are 0700 even when no file is secret."""


class Store:
    """Writes below its roots.

    Args:
        roots: absolute folders that may be written to, each with whether it is private: then every folder below
            it is 0700. Each is created when it is needed.
        records: folder of the lock, of the mark of a run under way and of the record; below one of the roots.
    """

    def __init__(self, roots: Mapping[Path, bool], records: Path) -> None:
        # The longest root first: a path belongs to the innermost.
        self._roots = dict(sorted(roots.items(), key=lambda item: len(item[0].parts), reverse=True))
        self._prefixes = {f"{root}/": root for root in self._roots}
        self._records = records
        self._mark = records / "running"

    # -- sessions ------------------------------------------------------------------------------------------------

    @contextlib.contextmanager
    def locked(self, on_wait: Callable[[], None]) -> Iterator[None]:
        """Hold the workspace's lock, so that two runs at once do not meet.

        Args:
            on_wait: called once when another run holds the lock, before waiting for it.
        """
        with self._open_folder(self._records, private=False) as records:
            try:
                lock = os.open("lock", os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o644, dir_fd=records)
            except OSError as error:
                refuse(self._records / "lock", error)
        try:
            with reported(self._records / "lock"):
                try:
                    fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                except BlockingIOError:
                    on_wait()
                    fcntl.flock(lock, fcntl.LOCK_EX)
            yield
        finally:
            os.close(lock)

    @contextlib.contextmanager
    def marked(self, content: bytes) -> Iterator[None]:
        """Mark a run that writes as under way; only a run that ends well takes the mark back.

        Args:
            content: what the next run must know if this one does not end well; see :func:`keymint.state.load`.
        """
        self.write(self._records, {self._mark.name: _Plain(content)})
        yield
        with reported(self._mark), contextlib.suppress(FileNotFoundError):
            os.unlink(self._mark)

    def is_marked(self) -> bool:
        """Tell whether an earlier run did not end well."""
        return self._mark.exists()

    def sweep(self) -> None:
        """Remove what a run that was killed left behind, and put in its place what it left waiting for that."""
        # A run that is killed while it sets its mark leaves something in the folder of records only.
        for root in self._roots if self.is_marked() else [self._records]:
            for folder, folders, files in os.walk(root):
                for name in filter(is_waiting, folders):
                    with self._opened_to_sweep(Path(folder)) as opened, reported(Path(folder) / name):
                        finish(opened, name)
                for name in filter(is_temporary, (*folders, *files)):
                    path = Path(folder) / name
                    with reported(path):
                        if path.is_dir() and not path.is_symlink():
                            shutil.rmtree(path)
                        else:
                            path.unlink()
                folders[:] = (name for name in folders if not is_temporary(name) and not is_waiting(name))

    @staticmethod
    @contextlib.contextmanager
    def _opened_to_sweep(folder: Path) -> Iterator[int]:
        with reported(folder):
            opened = os.open(folder, FOLDER)
        try:
            yield opened
        finally:
            os.close(opened)

    # -- writing -------------------------------------------------------------------------------------------------

    def change(self, changes: Iterable[WritableFolder]) -> None:
        """Write and remove files; what changes in one folder changes in one step.

        A folder in which several files change is replaced as a whole, together with what changes in the folders
        inside of it. A root of the store is none such: it may be a mount point.

        Args:
            changes: what changes, by folder, in this order; a folder may be named again.

        Raises:
            KeymintError: a place is not below a root, a link stands in the way, or the system refuses.
        """
        merged = self._merged(changes)
        replaced = {folder for folder, change in merged.items() if self._is_replaced(folder, change)}
        units: dict[Path, dict[Path, _Change]] = {}
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

    def write(self, folder: Path, files: Mapping[str, WritableFile], *, private: bool = False) -> None:
        """Write files into a folder, all in one step; see :meth:`change`."""
        self.change([_Change(folder, dict(files), (), private)])

    def remove(self, folder: Path, names: Sequence[str]) -> None:
        """Remove files from a folder, and the folder and its parents below the root when they become empty."""
        self.change([_Change(folder, {}, tuple(names))])

    def _merged(self, changes: Iterable[WritableFolder]) -> dict[Path, _Change]:
        """Return one change for each folder that something changes in."""
        merged: dict[Path, _Change] = {}
        for change in changes:
            folder, before = change.folder, merged.get(change.folder, _Change(change.folder))
            for name in (*change.files, *change.removed):
                check_component(name, folder)
            root = self._root_of(folder) if change.files or change.removed else None
            if root is None:
                continue
            private = self._roots[root] or change.private or any(file.secret for file in change.files.values())
            files = {name: file for name, file in before.files.items() if name not in change.removed}
            removed = tuple(name for name in before.removed if name not in change.files) + tuple(change.removed)
            merged[folder] = _Change(folder, {**files, **change.files}, removed, private or before.private)
        return {folder: merged[folder] for folder in self._outer_first(merged)}

    def _outer_first(self, folders: Iterable[Path]) -> Iterator[Path]:
        """Yield folders in their order, but a new one before those inside of it, so that it appears whole."""
        known = dict.fromkeys(folders)
        for folder in known:
            for outer in (*reversed(folder.parents), folder):
                if outer in known and (outer == folder or not (self._stays(outer) or os.path.lexists(outer))):
                    yield outer

    def _is_replaced(self, folder: Path, change: _Change) -> bool:
        """Tell whether a folder is replaced as a whole: a single file is replaced in one step anyway."""
        several = len({*change.files, *change.removed}) > 1
        return several and not self._stays(folder) and os.path.lexists(folder)

    def _content(self, outermost: Path, changes: Mapping[Path, _Change]) -> Content:
        """Return what becomes of a folder, from what changes in it and in the folders inside."""
        mode = 0o700 if self._roots[self._root_of(outermost)] else 0o755
        content = Content(mode=mode)
        for folder, change in changes.items():
            inner = content
            for part in folder.relative_to(outermost).parts:
                check_component(part, folder)
                inner = inner.folders.setdefault(part, Content(mode=mode))
            inner.files, inner.removed, inner.private = dict(change.files), set(change.removed), change.private
        return content

    def _replace_folder(self, folder: Path, content: Content) -> None:
        """Replace a folder as a whole, or remove it when nothing is left in it."""
        with self._open_folder(folder.parent, private=False) as parent, contextlib.ExitStack() as opened:
            staged: str | None = temporary()
            try:
                with reported(folder):
                    old = os.open(folder.name, FOLDER, dir_fd=parent)
                    opened.callback(os.close, old)
                    if mount_of(old) != mount_of(parent):
                        refuse_mount(folder)
                    carried = stage(old, parent, str(staged), folder, content)
                    if carried is not None:
                        new = os.open(str(staged), FOLDER, dir_fd=parent)
                        opened.callback(os.close, new)
                        staged = take_place(parent, str(staged), folder.name)  # now the name of the old one
                        if staged is not None:
                            clear(parent, staged, new, carried)
            except BaseException:
                # Whatever has the temporary name is not needed: the new folder before, the old one after.
                shutil.rmtree(str(staged), ignore_errors=True, dir_fd=parent)
                raise
        if carried is None:
            self._remove_whole(folder)

    def _write(self, folder: Path, change: _Change) -> None:
        """Write files one by one, or a new folder that appears with all of them."""
        if not change.files:
            return
        if folder not in self._roots and not os.path.lexists(folder) and self._write_new(folder, change):
            return
        with self._open_folder(folder, private=change.private) as opened:
            for name, file in change.files.items():
                self._replace(opened, folder, name, file)
            with reported(folder):
                os.fsync(opened)

    def _write_new(self, folder: Path, change: _Change) -> bool:
        """Write a folder that does not exist yet under a temporary name and rename it to its place.

        Returns:
            False when someone else made the folder meanwhile.
        """
        closed = self._roots[self._root_of(folder)]
        with self._open_folder(folder.parent, private=closed) as parent:
            staged = temporary()
            check_component(folder.name, folder.parent)
            try:
                add(parent, staged, folder, Content(dict(change.files), private=change.private))
                with reported(folder):
                    os.rename(staged, folder.name, src_dir_fd=parent, dst_dir_fd=parent)
                    os.fsync(parent)
            except BaseException as error:
                # Under its temporary name only: when the rename was done, an interrupt must not empty the folder.
                shutil.rmtree(staged, ignore_errors=True, dir_fd=parent)
                if os.path.isdir(folder) and isinstance(error, KeymintError):
                    return False
                raise
        return True

    def _replace(self, folder: int, shown: Path, name: str, file: WritableFile) -> None:
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
        """Remove files one by one, or a folder that holds nothing else as a whole."""
        if not os.path.lexists(folder):
            return
        with self._open_folder(folder, private=False) as opened:
            with reported(folder):
                whole = not self._stays(folder) and set(os.listdir(opened)) <= set(names)
            if not whole:
                for name in names:
                    with reported(folder / name), contextlib.suppress(FileNotFoundError):
                        os.unlink(name, dir_fd=opened)
            with reported(folder):
                os.fsync(opened)
        if whole:
            self._remove_whole(folder)

    def _stays(self, folder: Path) -> bool:
        """Tell whether a folder is there for good, whatever it holds."""
        return folder in self._roots or folder == self._records

    def _remove_whole(self, folder: Path) -> None:
        """Remove a folder, with the parents that hold nothing else, by renaming the outermost first."""
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
                away = outermost.name  # overlayfs renames no folder of a lower layer: it goes file by file
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
        raise KeymintError("lies outside of the workspace", where=Origin(str(path)), code="confined")

    @contextlib.contextmanager
    def _open_folder(self, path: Path, *, private: bool) -> Iterator[int]:
        """Open a folder below a root, made where it is missing, without following a link on the way."""
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


@dataclass(frozen=True, slots=True)
class _Change:
    """Implements :class:`WritableFolder`."""

    folder: Path
    files: Mapping[str, WritableFile] = field(default_factory=dict)
    removed: Sequence[str] = ()
    private: bool = False


class _Plain:
    """A public file."""

    secret = False

    def __init__(self, content: bytes) -> None:
        self.content = content
