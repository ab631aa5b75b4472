# SPDX-License-Identifier: Apache-2.0
"""Check modes, owners, links and kinds of the files and folders of a workspace.

Whoever can write to a folder can replace its files, whatever their modes. Whoever can write to the profile or the
sources decides what every robot may do.
"""

from __future__ import annotations

import grp
import os
import pwd
import stat
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path

from comarmor.errors import Diagnostic, Origin, Severity
from comarmor.values import dataclass
from keymint.session import Inputs

_GROUP, _OTHERS = stat.S_IWGRP, stat.S_IWOTH


@dataclass(frozen=True, slots=True)
class _Entry:
    """A file or folder of a space, and its status (of a link: of the link itself)."""

    path: str
    status: os.stat_result


def file_status(inputs: Inputs) -> Iterator[Diagnostic]:
    """Yield the findings on modes, owners, links and kinds of files in all spaces."""
    workspace = inputs.workspace
    owners = _owners(inputs)
    root = inputs.tree.status(workspace.root)
    if root is not None:
        yield from _open_to_others(inputs, [_Entry(str(workspace.root), root)])
    private = list(_walk(inputs, workspace.private))
    for entries in (private, *(list(_walk(inputs, each)) for each in (workspace.install, workspace.next_install))):
        yield from _kinds(inputs, entries)
        yield from _each_folder(inputs, entries)
        yield from _owned_by_others(inputs, entries, owners)
    yield from _private(inputs, private)
    for space in (workspace.build, workspace.public, workspace.state, workspace.profile, workspace.src):
        entries = [each for each in _walk(inputs, space) if not stat.S_ISLNK(each.status.st_mode)]
        yield from _open_to_others(inputs, entries)
        yield from _owned_by_others(inputs, entries, owners)


def modes(inputs: Inputs, path: Path | str, mode: int, subject: str) -> Iterator[Diagnostic]:
    """Yield a finding for a symbolic link or an unexpected mode; none if the file does not exist."""
    status = inputs.tree.status(path)
    existing = None if status is None else stat.S_IMODE(status.st_mode)
    if status is None or existing is None or (existing == mode and not stat.S_ISLNK(status.st_mode)):
        return
    shown = inputs.workspace.shown(path)
    if stat.S_ISLNK(status.st_mode):
        yield Diagnostic(
            "file-link",
            Severity.ERROR,
            "is a symbolic link, which breaks when the enclave is copied",
            Origin(shown),
            "remove it and run 'keymint install'",
            subject,
        )
    else:
        yield Diagnostic(
            "file-mode",
            Severity.ERROR if existing & ~mode & 0o077 else Severity.WARNING,
            f"has mode {existing:04o}, expected {mode:04o}",
            Origin(shown),
            f"chmod {mode:o} {shown}",
            subject,
        )


def linked_twice(inputs: Inputs, path: Path | str, subject: str) -> Iterator[Diagnostic]:
    """Yield a finding for a private key that has a second name (a hard link) somewhere."""
    status = inputs.tree.status(path)
    if status is not None and stat.S_ISREG(status.st_mode) and status.st_nlink > 1:
        yield Diagnostic(
            "key-linked",
            Severity.ERROR,
            f"is a private key with {status.st_nlink} names: another one leads to it from elsewhere",
            inputs.workspace.origin(path),
            f"find the others with 'find / -xdev -inum {status.st_ino}', and remove them",
            subject,
        )


def _private(inputs: Inputs, entries: list[_Entry]) -> Iterator[Diagnostic]:
    """Check modes and links of all private keys and their folders."""
    for each in entries:
        if stat.S_ISDIR(each.status.st_mode) or stat.S_ISLNK(each.status.st_mode):
            yield from modes(inputs, each.path, 0o700, "")
        elif _is_pem(each.path):
            yield from modes(inputs, each.path, 0o600, "")
            yield from linked_twice(inputs, each.path, "")


def _kinds(inputs: Inputs, entries: list[_Entry]) -> Iterator[Diagnostic]:
    """Report entries that are neither files nor folders; links are reported with the modes."""
    for each in entries:
        mode = each.status.st_mode
        if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode) or stat.S_ISLNK(mode)):
            yield Diagnostic(
                "file-kind",
                Severity.ERROR,
                f"is {_kind(mode)}, where files and folders are expected",
                inputs.workspace.origin(each.path),
                "remove it",
            )


def _kind(mode: int) -> str:
    kinds = ((stat.S_ISFIFO, "a named pipe"), (stat.S_ISSOCK, "a socket"))
    return next((name for is_kind, name in kinds if is_kind(mode)), "a device")


def _each_folder(inputs: Inputs, entries: list[_Entry]) -> Iterator[Diagnostic]:
    """Report folders of a space created by Keymint that others can write to."""
    for each in entries:
        mode = each.status.st_mode
        if stat.S_ISDIR(mode) and mode & (_GROUP | _OTHERS):
            shown = inputs.workspace.shown(each.path)
            yield Diagnostic(
                "place-writable",
                Severity.ERROR,
                f"has mode {stat.S_IMODE(mode):04o}: others can replace what lies in it",
                Origin(shown),
                f"chmod go-w {shown}",
            )


def _is_pem(path: str) -> bool:
    return os.path.splitext(path)[1] == ".pem"  # noqa: PTH122 - of a text


def _open_to_others(inputs: Inputs, entries: list[_Entry]) -> Iterator[Diagnostic]:
    """Yield one finding for all files and folders of a space that others can write to."""
    writable = [each for each in entries if _writable_by_others(each.status)]
    if writable:
        first = inputs.workspace.shown(writable[0].path)
        more = f", and {len(writable) - 1} more below it or beside it" if len(writable) > 1 else ""
        yield Diagnostic(
            "place-writable",
            Severity.WARNING,
            f"others can write this{more}, and with it decide what the robots may do",
            Origin(first),
            f"chmod -R go-w {inputs.workspace.shown(entries[0].path)}" if more else f"chmod go-w {first}",
        )


def _owned_by_others(inputs: Inputs, entries: list[_Entry], owners: frozenset[int]) -> Iterator[Diagnostic]:
    """Yield one finding for all files and folders of a space that belong to others, and one for each such key."""
    foreign = [each for each in entries if each.status.st_uid not in owners]
    keys = [each for each in foreign if _is_pem(each.path)]
    for each in keys or foreign[:1]:
        more = "" if keys or len(foreign) == 1 else f", like {len(foreign) - 1} more below it or beside it"
        yield Diagnostic(
            "file-owner",
            Severity.ERROR,
            f"belongs to {_user(each.status.st_uid)}, who can change it{more}",
            inputs.workspace.origin(each.path),
            f"chown {_user(min(owners - {0}, default=0))} {inputs.workspace.shown(each.path)}",
        )


def _walk(inputs: Inputs, folder: Path) -> Iterator[_Entry]:
    """Yield a folder and everything below it; unreadable folders are reported where their content is checked."""
    status = inputs.tree.status(folder)
    if status is None:
        return
    yield _Entry(str(folder), status)
    for path, _ in inputs.tree.walk(folder) if stat.S_ISDIR(status.st_mode) else ():
        if (status := inputs.tree.status(path)) is not None:
            yield _Entry(path, status)


def _owners(inputs: Inputs) -> frozenset[int]:
    """Return the users who may own files of a workspace: its owner, the current user, and root."""
    status = inputs.tree.status(inputs.workspace.root)
    return frozenset({0, os.geteuid()} | ({status.st_uid} if status else set()))


def _writable_by_others(status: os.stat_result) -> bool:
    mode = status.st_mode
    return bool(mode & _OTHERS) or (bool(mode & _GROUP) and not _is_own_group(status.st_uid, status.st_gid))


@lru_cache(maxsize=256)
def _is_own_group(user: int, group: int) -> bool:
    """Tell whether a group is a user's private group (login.defs: USERGROUPS_ENAB)."""
    try:
        name, entry = pwd.getpwuid(user).pw_name, grp.getgrgid(group)
    except KeyError:
        return False
    return entry.gr_name == name and set(entry.gr_mem) <= {name}


def _user(number: int) -> str:
    try:
        return pwd.getpwuid(number).pw_name
    except KeyError:
        return f"user {number}"
