# SPDX-License-Identifier: Apache-2.0
"""Answer a command that was carried out before, if nothing changed that its answer depends on.

A run records what the same command would print next time, and everything that this depends on. The command is then
answered without reading a document, so neither an XML parser nor cryptography is loaded. Whatever is in doubt is a
reason to carry the command out. If the policy changed, or some folders did, it is carried out, but packages whose
folders are as they were are not looked at again: see :attr:`Sight.changed`.

The status of the files in a folder tells without reading them whether they are what they were. A file that changes gets
another change time (ctime), which no program can set. So the same inode, size, mode, owner and times mean the same
file, unless it changed twice within one tick of the file system's clock. The rule is that of git: a status is trusted
only if the clock had moved on before it was taken. The same holds for a folder and the names in it (POSIX marks its
times when a name is made or removed), so what is known by name is not listed again.
"""

from __future__ import annotations

import contextlib
import hashlib
import marshal
import os
import stat
import sys
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from datetime import datetime
from functools import cached_property
from itertools import takewhile
from operator import attrgetter
from typing import Any, NamedTuple

from comarmor.text import lazy_regex
from comarmor.values import Data, values_of
from keymint import __version__
from keymint.view.stamps import one_of, sealed_document, unsealed_document

VERSION = 3
VERBS = ("create", "build", "install", "provision", "status")
"""The verbs whose answers are recorded."""
_RECORDS, _RECORD, _MARK = ".keymint", "state.json", "running"
_PROFILE = "profile/keymint_profile.xml"
DEFAULTS_FILE = "keymint.toml"
"""Name of the files with defaults of options; that of a workspace is at its root."""
_UNRECORDED = ("--hints", "--profile-space", "--new-authority", "--rekey", "--from", "--state", "--force", "-f")
"""Options of commands that do something each time, or read more than what is recorded."""
_VARIABLES = {"ROS_DISTRO", "ROS_DOMAIN_ID", "AMENT_PREFIX_PATH"}
"""Environment variables whose values may be recorded; any other one may be a password."""
_TICK, _COARSE_TICK = 20_000_000, 2_000_000_000
"""Nanoseconds in which a file may change twice and have the same time; the second if times are whole seconds."""
_DATE = lazy_regex(rb"-(?<=(\d{4}-))(\d\d-\d\dT\d\d:\d\d:\d\d(?:\.\d+)?(?:Z|[+-]\d\d:\d\d))")  # few bytes are "-"
_ALWAYS = 1e12
NEVER = 1 << 63
"""In place of a time: the status of this folder is never trusted, e.g. because it contains a link."""
_SKIPPED = ".git"
_WHOLE = "provision"
"""The verb that goes through all stages with all packages."""
_STATUS = attrgetter("st_mode", "st_uid", "st_gid", "st_size", "st_mtime_ns", "st_ctime_ns", "st_ino", "st_dev")


class Call(Data, slots=False):
    """A command, and where it is given.

    Attributes:
        arguments: arguments of the command line.
        cwd: current directory.
        colours: whether results and diagnostics have colours.
        now: the time of the run, in seconds.
        started: the clock of the system, in nanoseconds.
        environment: environment variables.
        width: columns of a table; None if it goes to no terminal.
        variables: environment variables that may be defaults of options.
        user_defaults: the file with the user's defaults of options; empty if there is no home directory.
    """

    arguments: Sequence[str]
    cwd: str
    colours: tuple[bool, bool]
    now: float
    started: int
    environment: Consulted
    width: int | None = None
    variables: Sequence[tuple[str, str]] = ()
    user_defaults: str = ""

    @cached_property
    def registrations(self) -> Mapping[str, str]:
        """What :func:`software_metadata` returns when it is first asked for: the software that a run has."""
        return software_metadata()


class Answer(Data):
    """What a command will print if nothing changes.

    Attributes:
        out: its results.
        err: its diagnostics.
        exit_code: its exit code.
        settled: it will find every package unchanged, and tell nothing about one.
        is_certain: it prints this; else only the rest is known.
    """

    out: str
    err: str
    exit_code: int
    settled: bool = False
    is_certain: bool = True


class Consulted(Mapping[str, str]):
    """Environment variables that remember which ones were asked for.

    Args:
        variables: the variables.
    """

    def __init__(self, variables: Mapping[str, str]) -> None:
        self._variables = variables
        self.names: set[str] = set()

    def __getitem__(self, name: str) -> str:
        self.names.add(name)
        return self._variables[name]

    def __iter__(self) -> Iterator[str]:
        self.names.update(self._variables)
        return iter(self._variables)

    def __len__(self) -> int:
        return len(self._variables)


def recall(call: Call) -> Answer | None:
    """Return the answer to a command that was carried out before, or None if it must be carried out."""
    root = _root(call)
    recorded, listing = _recorded(call, root) if root is not None else (None, b"")
    if (
        recorded is None
        or not recorded["is_certain"]
        or os.path.lexists(f"{root}/{_RECORDS}/{_MARK}")
        or any(path_status(path)[0] != status for path, status in recorded["status"].items())
    ):
        return None
    alike = _listed(listing)
    # A folder that is new below a known one has changed that one.
    new = walk(space for space in recorded["spaces"] if not any(space in digests for _, _, digests in alike))
    known = ((folder, digest, files) for files, _, digests in alike for folder, digest in digests.items())
    if not alike or new or not all(_unchanged(known, root or "")):
        return None
    return Answer(recorded["out"], recorded["err"], recorded["exit_code"])


def known_folders(call: Call, root: str, spaces: Sequence[str]) -> Mapping[str, FolderStatus]:
    """Return the folders of some spaces as the same command left them when it was carried out before.

    There are none if their packages may differ from what it left for another reason: the record was written since, it
    told something, or a date has passed that it compared with the clock.
    """
    is_whole = call.arguments[:1] == [_WHOLE] and _root(call) == root
    recorded, listing = _recorded(call, root) if is_whole else (None, b"")
    state = f"{root}/{_RECORDS}/{_RECORD}"
    if (
        recorded is None
        or not recorded["settled"]
        or recorded["spaces"] != list(spaces)
        or recorded["status"].get(state) != path_status(state)[0]
    ):
        return {}
    return _known(listing)


def _recorded(call: Call, root: str) -> tuple[Mapping[str, Any] | None, bytes]:
    """Return the record of a command and that of its folders; None if there is none of this command at this time."""
    try:
        with open(f"{root}/{_RECORDS}/{name_of(call)}", "rb") as opened:  # noqa: PTH123 - the path is a text
            own, end, listing = opened.read().partition(b"\n")
    except OSError:
        return None, b""
    recorded = unsealed_document(own + end, VERSION)
    if (
        recorded is None
        or recorded["call"] != _identity(call, root, recorded["variables"])
        or not recorded["from"] <= call.now < recorded["until"]
        or any(_real(call, path) != real for path, real in recorded["real"].items())
    ):
        return None, b""
    return recorded, listing


def _listed(listing: bytes) -> Sequence[tuple[tuple[str, ...], tuple[str, ...], Mapping[str, str]]]:
    """Return names of files and of folders, and the digest of each folder with these; none if the record is damaged."""
    recorded = unsealed_document(listing, VERSION) or {"folders": ()}
    return [(tuple(files), tuple(folders), digests) for files, folders, digests in recorded["folders"]]


def _known(listing: bytes) -> Mapping[str, FolderStatus]:
    """Return the folders on record, whose files were older than the clock; none if the record is damaged."""
    return {
        folder: FolderStatus(digest, 0, files, folders)
        for files, folders, digests in _listed(listing)
        for folder, digest in digests.items()
    }


def is_recordable(call: Call, root: str) -> bool:
    """Tell whether a command is one that may be recorded for :func:`recall`.

    Args:
        call: the command.
        root: the root of the workspace.
    """
    return (
        bool(call.arguments)
        and call.arguments[0] in VERBS
        and _root(call) == root
        and not any(argument.startswith(_UNRECORDED) for argument in call.arguments)
        and call.environment.names <= _VARIABLES
    )


def record(
    call: Call, root: str, sight: Sight, seen: Mapping[str, str], dates: Iterable[datetime], answer: Answer
) -> bytes | None:
    """Return the record of a command for :func:`recall`, or None if something is in doubt.

    Args:
        call: the command, which is recordable.
        root: the root of the workspace.
        sight: the spaces as the command left them, and nothing else.
        seen: the paths that the policy was read from, each with its fingerprint: the SHA-256 if it is a file.
        dates: dates that the command may have compared with the clock, beside those in the record.
        answer: what the same command will print.
    """
    state = f"{root}/{_RECORDS}/{_RECORD}"
    operands = (argument for argument in call.arguments if not argument.startswith("-"))
    real = {path: _real(call, path) for path in (*operands, *sight.roots)}
    spaces = tuple(f"{real[space]}/" for space in sight.roots)
    elsewhere = (path for path in seen if not os.path.realpath(path).startswith(spaces))
    # A profile would make a folder between the root and the current directory a workspace.
    below = _upward(call.cwd if f"{call.cwd}/".startswith(f"{root}/") else "")
    profiles = (f"{folder}/{_PROFILE}" for folder in takewhile(lambda folder: folder != root, below))
    defaults = (f"{root}/{DEFAULTS_FILE}", call.user_defaults)
    others = {path: path_status(path) for path in (*elsewhere, *profiles, *defaults)}
    own = path_status(state)
    ticks = {newest: _TICK if newest % 1_000_000_000 else _COARSE_TICK for _, newest in others.values()}
    if (
        own[1] >= sight.clock
        or any(newest >= call.started - tick for newest, tick in ticks.items())
        or not all(_has_content(path, fingerprint) for path, fingerprint in seen.items())
    ):
        return None
    with open(state, "rb") as opened:  # noqa: PTH123 - the path is a text
        found = {b"".join(each.groups()) for each in _DATE.finditer(opened.readline())}  # no other line has dates
    recorded = (datetime.fromisoformat(text.decode()) for text in found)
    ends = [moment for date in (*dates, *recorded) if (moment := date.timestamp()) >= call.now]
    digests: dict[tuple[tuple[str, ...], ...], dict[str, str]] = {}
    for folder, each in sight.folders.items():
        digests.setdefault((each.files, each.folders), {})[folder] = each.digest
    own_record = sealed_document(
        {
            "version": VERSION,
            "call": _identity(call, root, call.environment.names),
            "variables": sorted(call.environment.names),
            "from": call.now,
            "until": min(ends, default=_ALWAYS),
            "real": real,
            "status": {state: own[0]} | {path: status for path, (status, _) in others.items()},
            "spaces": sight.roots,
            **values_of(answer),
        }
    )
    return own_record + sealed_document(
        {"version": VERSION, "folders": [(*names, own) for names, own in digests.items()]}
    )


def name_of(call: Call) -> str:
    """Return the name of the file that has the record of the last command of this verb."""
    return f"last-{call.arguments[0]}.json"


def _root(call: Call) -> str | None:
    """Return the root of the workspace that a command names, or that contains the current directory."""
    named = [index for index, argument in enumerate(call.arguments) if argument in {"-w", "--workspace"}]
    if named:
        return _real(call, *call.arguments[named[-1] + 1 :][:1])
    return next((folder for folder in _upward(call.cwd) if os.path.lexists(f"{folder}/{_RECORDS}")), None)


def _real(call: Call, *path: str) -> str:
    return os.path.realpath(os.path.join(call.cwd, *path))  # noqa: PTH118 - the path is a text


def _upward(folder: str) -> Iterator[str]:
    """Yield a folder and those above it."""
    while folder.startswith("/"):
        yield folder
        folder = folder.rpartition("/")[0]


def _identity(call: Call, root: str, variables: Iterable[str]) -> str:
    """Return a digest of who gives which command where, and of the installed software."""
    values = [(name, call.environment.get(name)) for name in sorted(variables)]
    user = os.geteuid(), os.getegid(), sorted(os.getgroups())
    shown = call.colours, call.width, call.variables, call.user_defaults
    command = list(call.arguments), call.cwd, shown, root, values, user
    software = __version__, sys.version, {folder: _status(folder or ".") for folder in sys.path}, call.registrations
    return hashlib.sha256(repr((command, software)).encode()).hexdigest()


def software_metadata() -> Mapping[str, str]:
    """Return the folder of metadata of each distribution that may register plugins, and the status of its files."""
    found: dict[str, str] = {}
    for folder in sys.path:
        try:
            names = sorted(os.listdir(folder or "."))  # noqa: PTH208 - the path is a text
        except OSError:
            continue
        for name in names:
            if name.endswith((".dist-info", ".egg-info")):
                metadata = f"{folder or '.'}/{name}"
                if registers := _status(f"{metadata}/entry_points.txt"):  # as most have none, the first question
                    found[metadata] = f"{registers} {_status(f'{metadata}/METADATA')}"
    return found


def _status(path: str) -> str:
    try:
        of = os.stat(path)  # noqa: PTH116 - the path is a text
    except OSError:
        return ""
    return f"{of.st_ino} {of.st_size} {of.st_mtime_ns} {of.st_ctime_ns}"


def _has_content(path: str, fingerprint: str) -> bool:
    """Tell whether a file still has the content that was read; whether a folder changed is told by its time."""
    try:
        with open(path, "rb") as opened:  # noqa: PTH123 - the path is a text
            return hashlib.sha256(opened.read()).hexdigest() == fingerprint
    except IsADirectoryError:
        return True
    except OSError:
        return not fingerprint


# -- the status of folders ---------------------------------------------------------------------------------------------


class FolderStatus(NamedTuple):
    """The status of a folder and of the files directly in it.

    Attributes:
        digest: of mode, owner, size, times, inode and device of the folder, and of each file.
        newest: the latest time of the folder and of any file, in nanoseconds.
        files: names of the files, sorted.
        folders: names of the folders, sorted.
    """

    digest: str
    newest: int
    files: tuple[str, ...]
    folders: tuple[str, ...]

    def is_trusted(self, clock: int) -> bool:
        """Tell whether the same status means the same files.

        Args:
            clock: the clock of the file system before the status was taken, in nanoseconds.
        """
        return self.newest < clock


def new_status(
    own: os.stat_result, files: Mapping[str, os.stat_result | None], folders: Iterable[str]
) -> FolderStatus | None:
    """Return the status of a folder from that of its files, just written, by name; None if one is a link."""
    if None in files.values():
        return None
    names = one_of(tuple(sorted(files)))
    rows = [_STATUS(own), *[_STATUS(files[name]) for name in names]]
    newest = max([ctime for _, _, _, _, _, ctime, _, _ in rows])  # of what is new, the content does not change later
    return FolderStatus(_digest(rows), newest, names, tuple(sorted(folders)))


def path_status(path: str) -> tuple[str, int]:
    """Return the status of a file or folder that may be anywhere, and its latest time; links are followed."""
    real = os.path.realpath(path)
    try:
        of = os.stat(real)  # noqa: PTH116 - of texts
    except OSError as error:
        return f"{real} {error.errno}", 0
    status = f"{real} {of.st_mode} {of.st_uid} {of.st_gid} {of.st_size} {of.st_mtime_ns} {of.st_ctime_ns} {of.st_ino}"
    return status, max(of.st_mtime_ns, of.st_ctime_ns)


def walk(folders: Iterable[str], known: Mapping[str, FolderStatus] | None = None) -> dict[str, FolderStatus]:
    """Return the status of folders, and of all folders below them except ``.git``; none of those that do not exist.

    Args:
        folders: the folders.
        known: what is known of some: a folder with the same status has the same names, so it is not listed.
    """
    roots, known = list(folders), known or {}
    rows = ((folder, each.digest, each.files) for folder, each in known.items())
    are_same = _unchanged(rows, os.path.commonpath(roots)) if known else ()
    same = {folder for folder, is_same in zip(known, are_same, strict=True) if is_same}
    if len(same) == len(known) and all(root in known or not os.path.lexists(root) for root in roots):
        return dict(known)
    found: dict[str, FolderStatus] = {}
    waiting = roots
    while waiting:
        folder = waiting.pop()
        status = known[folder] if folder in same else folder_status(folder)
        if status is not None:
            found[folder] = status
            waiting += [f"{folder}/{name}" for name in status.folders if name != _SKIPPED]
    return found


def _unchanged(known: Iterable[tuple[str, str, Iterable[str]]], above: str) -> Iterator[bool]:
    """Yield for each folder whether it and its files have the status that is known.

    Args:
        known: folders, each with its digest and the names of its files.
        above: a folder that most are in: the system finds what is in it sooner by a path that begins there.
    """
    opened, start = os.open(above, getattr(os, "O_PATH", os.O_RDONLY)), f"{above}/"  # which need not be readable
    try:
        for path, digest, files in known:
            folder = path.removeprefix(start)
            inside = f"{folder}/"
            try:
                of_files = [_STATUS(os.stat(inside + name, dir_fd=opened, follow_symlinks=False)) for name in files]
                yield digest == _digest([_STATUS(os.stat(folder, dir_fd=opened)), *of_files])
            except OSError:
                yield False
    finally:
        os.close(opened)


def _digest(rows: list[tuple[int, ...]]) -> str:
    return hashlib.blake2b(marshal.dumps(rows, 2), digest_size=16).hexdigest()  # version 2 has no references


def folder_status(
    folder: str, written: Collection[str] = (), since: int = NEVER, visible: int = NEVER
) -> FolderStatus | None:
    """Return the status of a folder, or None if it does not exist.

    Args:
        folder: the folder.
        written: names of files that this run wrote.
        since: if another file was modified after this time, the status is not trusted.
        visible: the same for the files that this run wrote: the time at which they appeared.
    """
    files: dict[str, tuple[int, ...]] = {}
    folders: list[str] = []
    owner: tuple[int, ...] = ()
    newest = 0
    try:
        own = os.stat(folder)  # noqa: PTH116 - of texts, because there are many
        owner, newest = _STATUS(own), max(own.st_mtime_ns, own.st_ctime_ns)
        with os.scandir(folder) as entries:
            for entry in entries:
                name = entry.name
                if entry.is_dir(follow_symlinks=False):
                    folders.append(name)
                    continue
                of = entry.stat(follow_symlinks=False)
                if not stat.S_ISREG(of.st_mode) or of.st_mtime_ns >= (visible if name in written else since):
                    newest = NEVER
                newest = max(newest, of.st_mtime_ns, of.st_ctime_ns)
                files[name] = _STATUS(of)
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError:
        newest = NEVER
    names = one_of(tuple(sorted(files)))
    return FolderStatus(_digest([owner, *map(files.__getitem__, names)]), newest, names, tuple(sorted(folders)))


class Sight(Data):
    """The folders of a workspace as they are before a run reads a file.

    Attributes:
        roots: the folders that were looked at, with all that is below them.
        folders: the status of each folder.
        clock: the clock of the file system before that, in nanoseconds; 0 if it is not known.
        changed: the folders that are not as the same command left them; None if all may be different.
    """

    roots: tuple[str, ...]
    folders: Mapping[str, FolderStatus]
    clock: int
    changed: Collection[str] | None = None

    @classmethod
    def of(cls, folders: Iterable[str], clock: int = 0, known: Mapping[str, FolderStatus] | None = None) -> Sight:
        """Look at folders and all that is below them; ``known`` is the result of :func:`known_folders`."""
        roots = tuple(folders)
        found = walk(roots, known)
        if not known:
            return cls(roots, found, clock)
        new = {folder for folder, status in found.items() if status is not known.get(folder)}
        return cls(roots, found, clock, new | (known.keys() - found.keys()))

    def names_in(self, folder: str) -> dict[str, bool] | None:
        """Return the names in a folder, sorted, each with whether it is a folder; None if that is not known."""
        status = self.folders.get(folder)
        if status is None or status.newest == NEVER:  # it may have links, or not be readable
            return None
        names = dict.fromkeys(status.files, False) | dict.fromkeys(status.folders, True)
        return dict(sorted(names.items())) if status.files and status.folders else names

    def after(
        self,
        changes: Iterable[tuple[str, Iterable[str], Iterable[str]]],
        visible: int,
        clock: int,
        seen: Mapping[str, FolderStatus],
    ) -> Sight | None:
        """Return what is there when the run is done, or None if something else may have changed meanwhile.

        Args:
            changes: folders, perhaps more than once, with the names of the files that the run wrote and removed there.
            visible: the clock of the file system before the first write became visible.
            clock: the clock of the file system, later than the last write.
            seen: the status of folders that the run created and nobody else has seen before, as it was then.
        """
        if not all(status.is_trusted(self.clock) for status in self.folders.values()):
            return None
        written: dict[str, set[str]] = {}
        removed: dict[str, set[str]] = {}
        for folder, new, gone in changes:
            if folder not in seen or seen[folder].files != tuple(sorted(new)):
                written.setdefault(folder, set()).update(new)
                removed.setdefault(folder, set()).update(gone)
        inside = tuple(f"{root}/" for root in self.roots)
        made = {folder: each for folder, each in seen.items() if folder not in written and folder.startswith(inside)}
        own = dict(_still_as_made(made, visible))
        if not all(status.is_trusted(clock) for status in own.values()):
            return None
        folders = {**self.folders, **own}
        inner: list[str] = []
        for folder in {*written, *_above((*written, *own), inside)} - own.keys():
            if not f"{folder}/".startswith(inside):
                continue
            before, new = self.folders.get(folder), written.get(folder, set())
            present = folder_status(folder, new, self.clock, visible)
            if present is None:
                folders.pop(folder, None)
                continue
            kept = set(before.files if before else ()).difference(removed.get(folder, ()))
            if {*present.files} != kept | new or not present.is_trusted(clock):
                return None
            folders[folder] = present
            inner += [f"{folder}/{name}" for name in present.folders if name != _SKIPPED]
        return Sight(self.roots, folders, clock) if folders.keys() >= set(inner) else None


def _still_as_made(made: Mapping[str, FolderStatus], visible: int) -> Iterator[tuple[str, FolderStatus]]:
    """Yield the folders that a run made, with their status, but those of folders in which names changed since."""
    for folder, status in made.items():
        if not status.folders:
            yield folder, status
            continue
        with contextlib.suppress(OSError):
            own = os.stat(folder)  # noqa: PTH116 - of texts, because there are many
            if own.st_mtime_ns < visible:  # else another process may have added a folder
                newest = max(own.st_mtime_ns, own.st_ctime_ns)
                yield folder, FolderStatus(_digest([_STATUS(own)]), newest, (), status.folders)


def _above(folders: Iterable[str], inside: tuple[str, ...]) -> set[str]:
    """Return the folders above some: their times change as names in them do."""
    above: set[str] = set()
    for each in folders:
        folder = each.rpartition("/")[0]
        while folder not in above and f"{folder}/".startswith(inside):
            above.add(folder)
            folder = folder.rpartition("/")[0]
    return above
