"""The only writer: confined, locked, atomic, and strict about modes.

* Every path is walked from one of the store's roots without following a link, so nothing is written elsewhere.
* A file is written beside its place, synchronised, and renamed over it. A folder that is new appears whole.
* A secret is 0600 from its first byte and its folder 0700, whatever the umask.
* What a killed run left behind is swept away by the next.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import itertools
import os
import shutil
import stat
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NoReturn, Protocol

from keymint.errors import KeymintError, Origin

_PREFIX = ".keymint-"
_SUFFIX = ".tmp"
_FOLDER = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC
_NEW_FILE = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
MAX_COMPONENT = 255
"""Bytes of a path's component on the file systems in use."""


class WritableFile(Protocol):
    """A file to write; see :class:`keymint.plan.model.File`."""

    @property
    def content(self) -> bytes:
        """The bytes."""

    @property
    def secret(self) -> bool:
        """Whether it is 0600 or 0644."""


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
        self._serial = itertools.count()

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
                _refuse(self._records / "lock", error)
        try:
            with _reported(self._records / "lock"):
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
        with _reported(self._mark), contextlib.suppress(FileNotFoundError):
            os.unlink(self._mark)

    def is_marked(self) -> bool:
        """Tell whether an earlier run did not end well."""
        return self._mark.exists()

    def sweep(self) -> None:
        """Remove the temporary files and folders of a run that was killed."""
        # A run that is killed while it sets its mark leaves something in the folder of records only.
        for root in self._roots if self.is_marked() else [self._records]:
            for folder, folders, files in os.walk(root):
                for name in filter(_is_temporary, (*folders, *files)):
                    path = Path(folder) / name
                    with _reported(path):
                        if path.is_dir() and not path.is_symlink():
                            shutil.rmtree(path)
                        else:
                            path.unlink()
                folders[:] = (name for name in folders if not _is_temporary(name))

    # -- writing -------------------------------------------------------------------------------------------------

    def write(self, folder: Path, files: Mapping[str, WritableFile], *, private: bool = False) -> None:
        """Write files into a folder, each whole or not at all; a new folder appears with all of them.

        Args:
            folder: absolute path below a root.
            files: files by name, written in this order.
            private: folders that are created are 0700 even when no file is secret.

        Raises:
            KeymintError: the place is not below a root, a link stands in the way, or the system refuses.
        """
        if not files:
            return
        for name in files:
            _check_component(name, folder)
        private = private or self._roots[self._root_of(folder)] or any(file.secret for file in files.values())
        if folder not in self._roots and not os.path.lexists(folder) and self._write_new(folder, files, private):
            return
        with self._open_folder(folder, private=private) as opened:
            for name, file in files.items():
                self._replace(opened, folder, name, file)
            with _reported(folder):
                os.fsync(opened)

    def remove(self, folder: Path, names: Sequence[str]) -> None:
        """Remove files from a folder, and the folder and its parents below the root when they become empty.

        A folder that holds nothing else vanishes whole.
        """
        for name in names:
            _check_component(name, folder)
        if not os.path.lexists(folder):
            return
        with self._open_folder(folder, private=False) as opened:
            with _reported(folder):
                whole = not self._stays(folder) and set(os.listdir(opened)) <= set(names)
            if not whole:
                for name in names:
                    with _reported(folder / name), contextlib.suppress(FileNotFoundError):
                        os.unlink(name, dir_fd=opened)
            with _reported(folder):
                os.fsync(opened)
        if whole:
            self._remove_whole(folder)

    def _stays(self, folder: Path) -> bool:
        """Tell whether a folder is there for good, whatever it holds."""
        return folder in self._roots or folder == self._records

    def _remove_whole(self, folder: Path) -> None:
        """Remove a folder of files, with the parents that hold nothing else, by renaming the outermost first."""
        outermost = folder
        with _reported(folder):
            while not self._stays(outermost.parent) and os.listdir(outermost.parent) == [outermost.name]:
                outermost = outermost.parent
        with self._open_folder(outermost.parent, private=False) as parent, _reported(folder):
            temporary = self._temporary()
            os.rename(outermost.name, temporary, src_dir_fd=parent, dst_dir_fd=parent)
            os.fsync(parent)
            shutil.rmtree(temporary, dir_fd=parent)
        above = outermost.parent
        with contextlib.suppress(OSError):  # not empty: it stays
            while not self._stays(above):
                os.rmdir(above)
                above = above.parent

    def _write_new(self, folder: Path, files: Mapping[str, WritableFile], private: bool) -> bool:
        """Write a folder that does not exist yet under a temporary name and rename it to its place.

        Returns:
            False when someone else made the folder meanwhile.
        """
        with self._open_folder(folder.parent, private=self._roots[self._root_of(folder)]) as parent:
            temporary = self._temporary()
            _check_component(folder.name, folder.parent)
            with _reported(folder):
                os.mkdir(temporary, 0o700, dir_fd=parent)
            try:
                self._fill(parent, temporary, folder, files, 0o700 if private else 0o755)
                with _reported(folder):
                    os.rename(temporary, folder.name, src_dir_fd=parent, dst_dir_fd=parent)
                    os.fsync(parent)
            except BaseException as error:
                # Under its temporary name only: when the rename was done, an interrupt must not empty the folder.
                shutil.rmtree(temporary, ignore_errors=True, dir_fd=parent)
                if os.path.isdir(folder) and isinstance(error, KeymintError):
                    return False
                raise
        return True

    def _fill(self, parent: int, name: str, shown: Path, files: Mapping[str, WritableFile], mode: int) -> None:
        """Write files into a folder that was just made."""
        with _reported(shown):
            folder = os.open(name, _FOLDER, dir_fd=parent)
        try:
            for file, content in files.items():
                self._create(folder, shown, file, content)
            with _reported(shown):
                os.fchmod(folder, mode)
                os.fsync(folder)
        finally:
            os.close(folder)

    def _replace(self, folder: int, shown: Path, name: str, file: WritableFile) -> None:
        with contextlib.suppress(FileNotFoundError):
            kind = os.lstat(name, dir_fd=folder).st_mode
            if not stat.S_ISREG(kind):
                what = "a symbolic link" if stat.S_ISLNK(kind) else "not a regular file"
                raise KeymintError(
                    f"is {what}, and is not replaced",
                    where=Origin(str(shown / name)),
                    help="remove it if it is not yours",
                    code="symlink-refused",
                )
        temporary = self._temporary()
        try:
            self._create(folder, shown, temporary, file)
            with _reported(shown / name):
                os.rename(temporary, name, src_dir_fd=folder, dst_dir_fd=folder)
        except BaseException:
            with contextlib.suppress(OSError):
                os.unlink(temporary, dir_fd=folder)
            raise

    def _create(self, folder: int, shown: Path, name: str, file: WritableFile) -> None:
        with _reported(shown / name):
            opened = os.open(name, _NEW_FILE, 0o600, dir_fd=folder)
            try:
                view = memoryview(file.content)
                while view:
                    view = view[os.write(opened, view) :]
                os.fchmod(opened, 0o600 if file.secret else 0o644)
                os.fsync(opened)
            finally:
                os.close(opened)

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
        with _reported(root):
            if not os.path.lexists(root):
                root.parent.mkdir(parents=True, exist_ok=True)
                with contextlib.suppress(FileExistsError):
                    _make_folder(root, 0o700 if self._roots[root] else 0o755)
            opened = os.open(root, _FOLDER)
        try:
            parts = path.relative_to(root).parts
            for depth, part in enumerate(parts):
                _check_component(part, path)
                with _reported(path):
                    last = depth == len(parts) - 1
                    inner = self._enter(opened, part, 0o700 if self._roots[root] or (private and last) else 0o755)
                os.close(opened)
                opened = inner
            if private and parts and stat.S_IMODE(os.fstat(opened).st_mode) & 0o077:
                with _reported(path):
                    os.fchmod(opened, 0o700)
            yield opened
        finally:
            os.close(opened)

    @staticmethod
    def _enter(folder: int, name: str, mode: int) -> int:
        try:
            return os.open(name, _FOLDER, dir_fd=folder)
        except FileNotFoundError:
            with contextlib.suppress(FileExistsError):
                _make_folder(name, mode, folder)
            return os.open(name, _FOLDER, dir_fd=folder)

    def _temporary(self) -> str:
        return f"{_PREFIX}{os.getpid()}-{next(self._serial)}{_SUFFIX}"


class _Plain:
    """A public file."""

    secret = False

    def __init__(self, content: bytes) -> None:
        self.content = content


def _make_folder(name: str | Path, mode: int, parent: int | None = None) -> None:
    """Make a folder with exactly this mode, whatever the umask."""
    os.mkdir(name, mode, dir_fd=parent)
    if stat.S_IMODE(os.stat(name, dir_fd=parent, follow_symlinks=False).st_mode) != mode:
        os.chmod(name, mode, dir_fd=parent)


def _is_temporary(name: str) -> bool:
    return name.startswith(_PREFIX) and name.endswith(_SUFFIX)


def _check_component(name: str, folder: Path) -> None:
    if name in {"", ".", ".."} or "/" in name or "\0" in name:
        raise KeymintError(f"{name!r} is not the name of a file", where=Origin(str(folder)), code="confined")
    if len(os.fsencode(name)) > MAX_COMPONENT:
        raise KeymintError(
            f"the name {name[:40]!r}… is longer than {MAX_COMPONENT} bytes",
            where=Origin(str(folder)),
            code="confined",
        )


@contextlib.contextmanager
def _reported(path: Path) -> Iterator[None]:
    """Turn what the system refuses into one line for the user."""
    try:
        yield
    except KeymintError:
        raise
    except OSError as error:
        _refuse(path, error)


def _refuse(path: Path, error: OSError) -> NoReturn:
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
