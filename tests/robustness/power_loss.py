# SPDX-License-Identifier: Apache-2.0
"""The states in which a loss of power may leave a disk, by a model that is weaker than any common file system.

A run is recorded call by call. A disk image is what a prefix of these calls may leave:

* A change of names in a folder (a new name, a rename, an exchange, a removal) is atomic. It is certain once its folder
  was synchronised; a change in two folders, once both were. Every subset of the changes that are not certain may be on
  the disk, in whatever order they were made. (POSIX promises no more; journals keep the order.)
* The data of a file are certain once the file was synchronised. Otherwise the file may be empty, hold the beginning,
  or as many zero bytes, or all of it. (Delayed allocation does all of these.)
* A mode that was set later is certain once the file or folder was synchronised. The mode at creation always holds.
* ``syncfs`` makes everything certain that came before.
"""

from __future__ import annotations

import contextlib
import functools
import itertools
import os
import stat
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from typing import Any

import pytest

from keymint.store import group_commit

Entry = tuple[int, str]
"""A name in a folder."""


@dataclass(frozen=True)
class Names:
    """Names that change together: the file or folder that each has afterwards, or None."""

    to: Mapping[Entry, int | None]


@dataclass(frozen=True)
class Data:
    """The content of a file after a write."""

    file: int
    content: bytes


@dataclass(frozen=True)
class Mode:
    """The mode of a file or folder from now on."""

    of: int
    mode: int


@dataclass(frozen=True)
class Sync:
    """A file or folder that is synchronised; everything, if None."""

    of: int | None


Event = Names | Data | Mode | Sync


@dataclass
class Recording:
    """A recorded run.

    Attributes:
        root: number of the top folder.
        created: mode at creation of everything that existed, by its number.
        links: targets of symbolic links.
        before: names before the run.
        contents: contents before the run.
        events: the calls of the run.
    """

    root: int
    created: dict[int, int] = field(default_factory=dict)
    before: dict[Entry, int] = field(default_factory=dict)
    contents: dict[int, bytes] = field(default_factory=dict)
    events: list[Event] = field(default_factory=list)


class Recorder:
    """Records the calls that change a folder on the disk.

    Args:
        top: the folder; everything in it is certain at the beginning.
    """

    def __init__(self, top: Path) -> None:
        self._serial = itertools.count()
        self._ids: dict[int, int] = {}
        """Number of each file and folder by its inode, which the system may use again."""
        self._written: dict[int, bytes] = {}
        self.recording = Recording(self._new(top.lstat()))
        self._known(top, self.recording.root)

    def _new(self, status: os.stat_result) -> int:
        self._ids[status.st_ino] = number = next(self._serial)
        return number

    def _known(self, folder: Path, above: int) -> None:
        self.recording.created[above] = stat.S_IMODE(folder.stat().st_mode)
        for path in folder.iterdir():
            number = self.recording.before[above, path.name] = self._new(path.lstat())
            if path.is_dir():
                self._known(path, number)
            else:
                self.recording.created[number] = stat.S_IMODE(path.stat().st_mode)
                self.recording.contents[number] = self._written[number] = path.read_bytes()

    @contextlib.contextmanager
    def patched(self) -> Iterator[Recording]:
        """Record while this context is open."""
        with pytest.MonkeyPatch.context() as patch:
            for call in ("open", "write", "mkdir", "rename", "link", "unlink", "rmdir", "fsync", "fchmod", "chmod"):
                patch.setattr(os, call, functools.partial(getattr(self, f"_{call}"), getattr(os, call)))
            patch.setattr(
                group_commit, "exchange_names", functools.partial(self._exchange, group_commit.exchange_names)
            )
            whole = functools.partial(self._syncfs, group_commit.sync_file_system)
            patch.setattr(group_commit, "sync_file_system", whole)
            yield self.recording

    def _entry(self, name: str | Path, folder: int | None = None) -> tuple[Entry | None, os.stat_result | None]:
        """Return a name in its folder, if that is recorded, and the status of what has this name."""
        path = Path(name)
        above = os.fstat(folder) if folder is not None else path.parent.stat()
        try:
            status: os.stat_result | None = os.stat(name, dir_fd=folder, follow_symlinks=False)
        except OSError:
            status = None
        number = self._ids.get(above.st_ino)
        return (None if number is None else (number, path.name)), status

    def _of(self, status: os.stat_result | None) -> int:
        assert status is not None
        return self._ids[status.st_ino]

    def _add(self, *events: Event) -> None:
        self.recording.events += events

    def _appear(self, entry: Entry | None, status: os.stat_result) -> None:
        if entry is not None:
            number = self._new(status)
            self.recording.created[number] = stat.S_IMODE(status.st_mode)
            if not stat.S_ISDIR(status.st_mode):
                self.recording.contents[number] = self._written[number] = b""
            self._add(Names({entry: number}))

    def _open(self, real: Any, path: Any, flags: int, mode: int = 0o777, *, dir_fd: int | None = None) -> int:
        entry, before = self._entry(path, dir_fd) if flags & os.O_CREAT else (None, None)
        opened: int = real(path, flags, mode, dir_fd=dir_fd)
        if before is None:
            self._appear(entry, os.fstat(opened))
        return opened

    def _write(self, real: Any, opened: int, content: bytes) -> int:
        written: int = real(opened, content)
        number = self._ids.get(os.fstat(opened).st_ino)
        if number in self._written:
            self._written[number] += bytes(content[:written])
            self._add(Data(number, self._written[number]))
        return written

    def _mkdir(self, real: Any, path: Any, mode: int = 0o777, *, dir_fd: int | None = None) -> None:
        real(path, mode, dir_fd=dir_fd)
        entry, status = self._entry(path, dir_fd)
        assert status is not None
        self._appear(entry, status)

    def _rename(
        self, real: Any, old: Any, new: Any, *, src_dir_fd: int | None = None, dst_dir_fd: int | None = None
    ) -> None:
        source, status = self._entry(old, src_dir_fd)
        target, _ = self._entry(new, dst_dir_fd)
        real(old, new, src_dir_fd=src_dir_fd, dst_dir_fd=dst_dir_fd)
        if source and target:
            self._add(Names({source: None, target: self._of(status)}))

    def _exchange(self, real: Any, parent: int, one: str, other: str) -> None:
        (first, before), (second, after) = self._entry(one, parent), self._entry(other, parent)
        real(parent, one, other)
        if first and second:
            self._add(Names({first: self._of(after), second: self._of(before)}))

    def _link(self, real: Any, old: Any, new: Any, **options: Any) -> None:
        real(old, new, **options)
        entry, status = self._entry(new, options.get("dst_dir_fd"))
        if entry:
            self._add(Names({entry: self._of(status)}))

    def _unlink(self, real: Any, path: Any, *, dir_fd: int | None = None) -> None:
        entry, _ = self._entry(path, dir_fd)
        real(path, dir_fd=dir_fd)
        if entry:
            self._add(Names({entry: None}))

    _rmdir = _unlink

    def _fsync(self, real: Any, opened: int) -> None:
        real(opened)
        number = self._ids.get(os.fstat(opened).st_ino)
        if number is not None:
            self._add(Sync(number))

    def _syncfs(self, real: Any, opened: int) -> bool:
        done: bool = real(opened)
        if done:
            self._add(Sync(None))
        return done

    def _fchmod(self, real: Any, opened: int, mode: int) -> None:
        real(opened, mode)
        number = self._ids.get(os.fstat(opened).st_ino)
        if number is not None:
            self._add(Mode(number, mode))

    def _chmod(self, real: Any, path: Any, mode: int, *, dir_fd: int | None = None) -> None:
        real(path, mode, dir_fd=dir_fd)
        _, status = self._entry(path, dir_fd)
        if status is not None and status.st_ino in self._ids:
            self._add(Mode(self._of(status), mode))


# -- images ------------------------------------------------------------------------------------------------------

Image = Mapping[str, tuple[int, bytes | None]]
"""The mode of every path on a disk, and the content of a file (None for a folder)."""


@dataclass(frozen=True)
class Crash:
    """A loss of power.

    Attributes:
        at: number of the events before it.
        keeps: tells whether an event that is not certain is on the disk nevertheless.
        damaged: returns what is left of data that are not certain.
    """

    at: int
    keeps: Callable[[int], bool]
    damaged: Callable[[bytes], bytes]


def certain(events: Sequence[Event]) -> set[int]:
    """Return the numbers of the events that a loss of power after all of them cannot undo."""
    synced: dict[int, int] = {}
    everything = -1
    for at, event in enumerate(events):
        if isinstance(event, Sync):
            if event.of is None:
                everything = at
            else:
                synced[event.of] = at
    found = set()
    for at, event in enumerate(events):
        if isinstance(event, Names):
            about = {folder for folder, _ in event.to}
        elif isinstance(event, Sync):
            continue
        else:
            about = {event.of if isinstance(event, Mode) else event.file}
        if at < everything or all(at < synced.get(each, -1) for each in about):
            found.add(at)
    return found


def image(recording: Recording, crash: Crash) -> Image:
    """Return what is on the disk after a loss of power."""
    events = recording.events[: crash.at]
    sure = certain(events)
    names: dict[Entry, int | None] = dict(recording.before)
    contents, modes = dict(recording.contents), dict(recording.created)
    for at, event in enumerate(events):
        if isinstance(event, Data):
            # What is written is not lost by halves more often than once: the last write decides.
            contents[event.file] = event.content if at in sure else crash.damaged(event.content)
        elif at in sure or crash.keeps(at):
            if isinstance(event, Names):
                names.update(event.to)
            elif isinstance(event, Mode):
                modes[event.of] = event.mode
    found: dict[str, tuple[int, bytes | None]] = {}

    def walk(folder: int, path: str) -> None:
        for (above, name), number in names.items():
            if above == folder and number is not None:
                found[f"{path}{name}"] = (modes[number], contents.get(number))
                if number not in contents:
                    walk(number, f"{path}{name}/")

    walk(recording.root, "")
    return found


def crashes(recording: Recording, random: Random, most: int) -> Iterator[Crash]:
    """Yield crashes: after each event, with none, all, all but one, one and some of what is not certain."""
    ends = list(range(len(recording.events) + 1))
    damages: list[Callable[[bytes], bytes]] = [
        lambda _: b"",
        lambda content: content[: len(content) // 2],
        lambda content: bytes(len(content)),
        lambda content: content,
    ]
    for _ in range(most):
        at, share = random.choice(ends), random.choice([0.0, 0.1, 0.5, 0.9, 1.0])
        kept = {each for each in range(at) if random.random() < share}
        yield Crash(at, kept.__contains__, random.choice(damages))


def write_image(found: Image, folder: Path) -> None:
    """Make a folder of an image."""
    folder.mkdir()
    for path, (_, content) in sorted(found.items()):
        place = folder / path
        if content is None:
            place.mkdir()
        else:
            place.write_bytes(content)
    for path, (mode, _) in found.items():
        (folder / path).chmod(mode)
