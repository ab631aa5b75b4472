# SPDX-License-Identifier: Apache-2.0
"""A read-only view of the workspace's files: the disk, overlaid with planned changes.

Stages plan against this view, so that one run can plan all of them before its first byte is written.
"""

from __future__ import annotations

import os
import stat
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from comarmor.values import Data, field
from keymint.errors import KeymintError
from keymint.view import file_reading
from keymint.view.file_reading import (
    MAX_FILE,
    REGISTER,
    FileStatus,
    is_temporary,
    linked_file,
    lstat,
    read_error,
    read_file,
)
from keymint.view.stamps import StampRow, digest, stamp_of

if TYPE_CHECKING:
    from keymint.view.recorded_answers import Sight

__all__ = ["MAX_FILE", "REGISTER", "Content", "File", "HeldError", "Tree", "read_error", "read_file"]

_Read = TypeVar("_Read")
_FEW = 4


class File(Data):
    """A file to write.

    Attributes:
        given: its bytes, of a link those of the file that it leads to; or what makes them, in pieces, whenever they are
            needed, if they would take memory until then.
        secret: its mode is 0600, else 0644.
        mode: another mode, e.g. that of the file that it replaces.
        link: the text of a symbolic link, which is written in place of the content; empty for a regular file.
        replaces_link: a symbolic link in its place is replaced; else that is refused.
    """

    given: bytes | Callable[[], Iterable[bytes]] = field(repr=False)
    secret: bool = False
    mode: int | None = None
    link: str = ""
    replaces_link: bool = False
    _digest: str = field(default="", init=False, repr=False, compare=False)

    def pieces(self) -> Iterable[bytes]:
        """Return the content in pieces."""
        return (self.given,) if isinstance(self.given, bytes) else self.given()

    @property
    def content(self) -> bytes:
        """The bytes that are written."""
        return self.given if isinstance(self.given, bytes) else b"".join(self.given())

    @property
    def digest(self) -> str:
        """The digest of the content; see :func:`keymint.view.stamps.digest`."""
        if not self._digest:
            object.__setattr__(self, "_digest", sys.intern(digest(self.content)))
        return self._digest


class HeldError(Exception):
    """A plan needs what another process holds: it must be made by one process."""


Place = tuple[str, tuple[str, ...], bool]
"""The folder around one in which files are new, with a slash; their names; whether the one is private."""


class HeldPackage:
    """The files of a package that another process holds: little is kept of them, as those of a fleet are alike.

    Args:
        name: the package, and so the path of each of its folders below the one around it.
        places: these folders.
        stamp: the stamp of the package as it is written.
    """

    __slots__ = ("name", "places", "stamp")

    def __init__(self, name: str, places: tuple[Place, ...], stamp: StampRow) -> None:
        self.name, self.places, self.stamp = name, places, stamp

    def files(self, around: str) -> Mapping[str, HeldPackage]:
        """Return the files in the folder below another one, each with the package, which knows its digest."""
        return {name: self for place, names, _ in self.places if place == around for name in names}

    def digest(self, name: str) -> str:
        """Return the digest of a file; empty if the stamp does not have it."""
        return stamp_of(self.stamp).outputs.get(name, "")


Content = bytes | File | HeldPackage | str | None
"""Planned content of a file; if another process holds it, its package or digest; None for one that will be removed."""


class Tree:
    """Files by absolute path, as they are at the first access.

    Each is read once from the disk, and perhaps once more for its digest.

    Args:
        linked: a folder in which symbolic links are followed that stay in it, as ROS 2 does in a keystore.
        sight: folders that were just looked at.
    """

    def __init__(self, linked: Path | None = None, sight: Sight | None = None) -> None:
        self._linked = str(linked or "")
        self._sight = sight
        self.changed = sight.changed if sight else None
        """The folders that are not as the same command left them before; see :attr:`Sight.changed`."""
        self._digests: dict[str, str | None] = {}
        self._contents: dict[str, bytes | KeymintError | None] = {}
        self._equal: dict[bytes | None, bytes | None] = {}
        """Contents that are held, each once: enclaves have many files in common."""
        self._entries: dict[str, dict[str, bool] | KeymintError] = {}
        self._statuses: dict[str, FileStatus | None] = {}
        self._links: set[str] = set()
        """Symbolic links among the paths whose status is known."""
        self._left_out: set[str] = set()
        self.remnants: set[str] = set()
        """What an interrupted run was about to put into folders that were listed; it counts as absent."""
        self._files: dict[str, Mapping[str, Content]] = {}
        """Planned content by folder and name."""
        self._folders: dict[str, tuple[str, ...] | set[str]] = {}
        """Names of planned folders, by the folder around them; few names take less memory as a tuple."""
        self._packages: dict[str, dict[str, HeldPackage]] = {}
        """Packages that another process holds, by the folder around theirs, with a slash, and name."""
        self._inside: dict[str, dict[str, set[str]]] = {}
        """Names of their folders by that folder, and by the path below it of the folder around them, with a slash."""

    def overlaid(
        self, changes: Iterable[tuple[Path | str, Mapping[str, Content]]], held: Iterable[HeldPackage] = ()
    ) -> Tree:
        """Return this view with more planned content, which hides the disk.

        Args:
            changes: folders, perhaps more than once, with the content of files by name; None for a file that will be
                removed. The view keeps these mappings.
            held: packages that another process holds.

        Raises:
            HeldError: one is planned already.
        """
        tree = Tree()
        tree.__dict__.update(self.__dict__)  # they share what is known of the disk
        files = tree._files = dict(self._files)
        tree._folders = dict(self._folders)
        # What is shared with other views is copied before it changes.
        own: dict[str, dict[str, Content]] = {}
        own_folders: dict[str, set[str]] = {}
        packages: dict[str, dict[str, HeldPackage]] = {}
        for each in held:
            for around, *_ in each.places:
                if self._planned_in(folder := f"{around}{each.name}"):
                    raise HeldError(folder)
                packages.setdefault(around, {})[each.name] = each
        for around in packages:
            tree._show(around[:-1], own_folders)
            packages[around] |= self._packages.get(around, {})
        tree._packages = self._packages | packages
        tree._inside = {around: known for around, known in self._inside.items() if around not in packages}
        for place, contents in changes:
            folder = str(place)
            if folder in own:
                own[folder].update(contents)
            elif known := tree._planned_in(folder):
                files[folder] = own[folder] = {**known, **contents}
            else:
                files[folder] = contents
            if any(content is not None for content in contents.values()):
                tree._show(folder, own_folders)
        return tree

    def _show(self, folder: str, own: dict[str, set[str]]) -> None:
        """Add a folder to those that are planned; ``own`` has the sets of names that belong to this view only."""
        folders = self._folders
        while folder:
            around, _, name = folder.rpartition("/")
            known = folders.get(around, ())
            if name in known:
                break
            if around in own:
                own[around].add(name)
            elif len(known) < _FEW:
                folders[around] = (*known, sys.intern(name))
            else:
                folders[around] = own[around] = {*known, name}
            folder = around

    def apart(self) -> Tree:
        """Return this view with a memory of its own of the disk."""
        tree = Tree()
        for name, known in vars(self).items():
            setattr(tree, name, known.copy() if isinstance(known, dict | set) else known)
        return tree

    @property
    def _plans(self) -> bool:
        """Whether anything is planned; a verb that does not write asks for many files."""
        return bool(self._files or self._packages)

    def _planned_in(self, folder: str) -> Mapping[str, Content]:
        """Return the planned content of a folder by name."""
        found = self._files.get(folder)
        for around, packages in self._packages.items() if found is None else ():
            if folder.startswith(around) and (package := packages.get(folder[len(around) :])):
                return package.files(around)
        return found or {}

    def _folders_of_packages(self, folder: str) -> Iterator[str]:
        """Yield the names in a folder of those with packages that another process holds."""
        place = f"{folder}/"
        for around in filter(place.startswith, self._packages):
            if around not in self._inside:
                inside = self._inside[around] = {}
                for package in self._packages[around]:
                    path = package
                    while path:
                        path, slash, name = path.rpartition("/")
                        inside.setdefault(path + slash, set()).add(name)
            yield from self._inside[around].get(place[len(around) :], ())

    def _planned(self, path: str) -> tuple[bool, Content]:
        """Return whether a file is planned, and its content: None if it will be removed."""
        if not self._plans:
            return False, None
        folder, _, name = path.rpartition("/")
        files = self._planned_in(folder)
        return (True, files[name]) if name in files else (False, None)

    def read(self, path: Path | str) -> bytes | None:
        """Return a file's bytes, or None if there is none; errors as :func:`read_file`."""
        path = str(path)
        planned, content = self._planned(path)
        if isinstance(content, HeldPackage | str):
            raise HeldError(path)
        if isinstance(content, File):
            return content.content
        return content if planned else self._read(path)

    def digest(self, path: Path | str) -> str | None:
        """Return the digest of a file (see :func:`keymint.view.stamps.digest`), or None if there is none.

        Raises:
            KeymintError: as :func:`read_file`.
        """
        path = str(path)
        is_planned, planned = self._planned(path)
        if is_planned:
            if isinstance(planned, bytes):
                return digest(planned)
            if isinstance(planned, HeldPackage):
                planned = planned.digest(path.rpartition("/")[2])
            if planned == "":
                raise HeldError(path)
            return planned.digest if isinstance(planned, File) else planned
        if path not in self._digests:
            kept = path in self._contents
            content = self._read(path)
            if not kept:  # a large fleet has more bytes than memory
                self._contents.pop(path, None)
            self._digests[path] = None if content is None else digest(content)
        return self._digests[path]

    def try_read(self, path: Path | str) -> bytes | None:
        """Return a file's bytes, or None if there is none or it cannot be read."""
        try:
            return self.read(path)
        except KeymintError:
            return None

    def status(self, path: Path | str) -> FileStatus | None:
        """Return the status of a path on the disk, or None if it does not exist.

        Links are not followed, except in the folder where :meth:`read` follows them.
        """
        path = str(path)
        if path not in self._statuses:
            if self._is_absent(path):
                return None
            self._statuses[path] = self._status(path)
        return self._statuses[path]

    def follows(self, path: Path | str) -> str:
        """Return the file that a symbolic link leads to, if :meth:`read` follows it; else an empty text."""
        path = str(path)
        return "" if path in self._statuses and path not in self._links else linked_file(path, self._linked)

    def hold(self, folder: Path, *, suffix: str = "", optional: str | None = None) -> None:
        """Read everything below a folder into memory, so that the disk is not accessed again.

        Errors are raised at the access to the file that cannot be read.

        Args:
            folder: absolute path; need not exist.
            suffix: only files with this suffix are read; of the others only their existence is known.
            optional: what has this suffix and the user is not permitted to read counts as absent, and is listed.
        """
        self._statuses[str(folder)] = lstat(str(folder))
        waiting = [str(folder)]
        while waiting:
            inner = waiting.pop()
            try:
                entries = self._entries[inner] = self._scan(inner)
            except KeymintError as error:
                self._entries[inner] = {} if self._leaves_out(inner, error, optional) else error
                continue
            for name, is_folder in entries.items():
                path = f"{inner}/{name}"
                if is_folder or not name.endswith(suffix):
                    self._statuses[path] = self._status(path)
                    waiting += [path] if is_folder and name != ".git" else []
                    continue
                try:
                    content = self._opened(path)
                    self._contents[path] = self._equal.setdefault(content, content)
                except KeymintError as error:
                    self._contents[path] = None if self._leaves_out(path, error, optional) else error

    @property
    def left_out(self) -> Sequence[str]:
        """What :meth:`hold` was not permitted to read, sorted; nothing is known of what is in such a folder."""
        return sorted(self._left_out)

    def is_left_out(self, path: Path | str) -> bool:
        """Tell whether a file is one of :attr:`left_out`, or in such a folder."""
        left_out = self._left_out
        return bool(left_out) and not left_out.isdisjoint(map(str, (path, *Path(path).parents)))

    def has_file(self, path: Path | str) -> bool:
        """Tell whether there is a regular file (no link, no folder), on the disk or planned."""
        planned, content = self._planned(str(path))
        if planned:
            return content is not None
        status = self.status(path)
        return status is not None and stat.S_ISREG(status.st_mode)

    def names(self, folder: Path | str) -> Sequence[tuple[str, bool]]:
        """Return the entries of a folder, sorted, each with whether it is a folder (links are not).

        Raises:
            KeymintError: the folder cannot be read.
        """
        folder = str(folder)
        entries = self._once(self._entries, folder, self._scan, {})
        if not self._plans:
            return list(entries.items())
        files, folders = self._planned_in(folder), {*self._folders.get(folder, ()), *self._folders_of_packages(folder)}
        if not files and not folders:
            return list(entries.items())
        there = {**entries, **{name: False for name, content in files.items() if content is not None}}
        there |= dict.fromkeys(folders, True)
        return sorted(item for item in there.items() if files.get(item[0], b"") is not None)

    def walk(self, folder: Path | str, skipped: str = ".git") -> Iterator[tuple[str, bool]]:
        """Yield everything below a folder, each with whether it is a folder; links are not followed.

        Folders that cannot be read are yielded, but not what is in them.

        Args:
            folder: absolute path.
            skipped: name of folders that are left out.
        """
        try:
            entries = self.names(folder)
        except KeymintError:
            return
        for name, is_folder in entries:
            path = f"{folder}/{name}"
            if not is_folder:
                yield path, False
            elif name != skipped:
                yield path, True
                yield from self.walk(path, skipped)

    def files(self, folder: Path | str, *, suffix: str = "", depth: int = 1) -> dict[str, bytes]:
        """Return the files whose names end with ``suffix`` by relative path, from ``depth`` levels of folders."""
        contents: dict[str, bytes] = {}
        for name, is_folder in self.names(folder):
            if is_folder:
                if depth > 1 and not name.startswith("."):
                    below = self.files(f"{folder}/{name}", suffix=suffix, depth=depth - 1)
                    contents |= {f"{name}/{inner}": content for inner, content in below.items()}
            elif name.endswith(suffix):
                content = self.read(f"{folder}/{name}")
                if content is not None:
                    contents[name] = content
        return contents

    # -- the disk ------------------------------------------------------------------------------------------------

    def _once(
        self, known: dict[str, _Read | KeymintError], path: str, read: Callable[[str], _Read], absent: _Read
    ) -> _Read:
        """Return what is known about a path, or raise its error; the disk is accessed at the first call."""
        if path not in known:
            if self._is_absent(path):
                return absent
            try:
                known[path] = read(path)
            except KeymintError as error:
                known[path] = error
        found = known[path]
        if isinstance(found, KeymintError):
            raise KeymintError.of(found.diagnostics, found.exit_code)
        return found

    def _read(self, path: str) -> bytes | None:
        return self._once(self._contents, path, self._file, None)

    def _file(self, path: str) -> bytes | None:
        try:
            return read_file(path)
        except KeymintError:
            if real := linked_file(path, self._linked):
                return read_file(real)
            raise

    def _opened(self, path: str) -> bytes | None:
        """Read a file, and keep the status that it has when it is opened."""
        try:
            content, self._statuses[path] = file_reading.read_open_file(path) or (None, None)
        except KeymintError:
            self._statuses[path] = self._status(path)
            return self._file(path)
        return content

    def _status(self, path: str) -> FileStatus | None:
        found = lstat(path)
        if found is None or not stat.S_ISLNK(found.st_mode):
            return found
        self._links.add(path)
        return lstat(linked_file(path, self._linked) or path)

    def _leaves_out(self, path: str, error: KeymintError, optional: str | None) -> bool:
        is_refused = isinstance(error.__cause__, PermissionError)
        is_left_out = is_refused and optional is not None and path.endswith(optional)
        self._left_out |= {path} if is_left_out else set()
        return is_left_out

    def _is_absent(self, path: str) -> bool:
        """Tell whether a path is known not to exist, because the folder around it, or one further out, was listed."""
        parent, _, name = path.rpartition("/")
        around = self._entries.get(parent)
        if around is None:
            return bool(parent) and self._is_absent(parent)
        return not isinstance(around, KeymintError) and name not in around

    def _scan(self, folder: str) -> dict[str, bool]:
        if self._sight is not None and (known := self._sight.names_in(folder)) is not None:
            return known
        try:
            with os.scandir(folder) as entries:
                found = dict(sorted([(entry.name, entry.is_dir(follow_symlinks=False)) for entry in entries]))
        except (FileNotFoundError, NotADirectoryError):
            return {}
        except OSError as error:
            raise read_error(folder, error) from error
        for name in [*filter(is_temporary, found)]:
            self.remnants.add(f"{folder}/{name}")
            del found[name]
        return found
