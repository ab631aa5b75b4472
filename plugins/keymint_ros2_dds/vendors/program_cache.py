# SPDX-License-Identifier: Apache-2.0
"""Find a folder for compiled probes: this user's cache if nobody else can write there, else a folder of this run.

A program from the cache runs with the rights of the user, so only a safe place is trusted.
"""

from __future__ import annotations

import functools
import os
import stat
import tempfile
from collections.abc import Iterator
from pathlib import Path


def place(cache: Path, name: str) -> Path:
    """Return the path of a program: in the cache, unless a file there is not trusted.

    Args:
        cache: a folder for programs.
        name: the program's.
    """
    program = folder(cache) / name
    return program if is_ours(program) or not os.path.lexists(program) else Path(_of_this_run().name) / name


def folder(cache: Path) -> Path:
    """Return the cache, created if missing, if only this user can write it; else a private folder of this run.

    Args:
        cache: a folder for programs.
    """
    try:
        cache.mkdir(mode=0o700, parents=True, exist_ok=True)
    except OSError:
        return Path(_of_this_run().name)
    return cache if is_ours_alone(cache) else Path(_of_this_run().name)


def is_ours_alone(path: Path) -> bool:
    """Tell whether a folder is this user's, has mode 0700, is not a link, and cannot be replaced by others.

    Only root and this user may own or write its parent folders; in one with the sticky bit, like ``/tmp``, others can
    write, but cannot rename our files.
    """
    try:
        own = path.lstat()
        ours = stat.S_ISDIR(own.st_mode) and stat.S_IMODE(own.st_mode) == stat.S_IRWXU and own.st_uid == os.geteuid()
        return ours and all(map(_is_safe, _above(path)))
    except OSError:
        return False


def is_ours(program: Path) -> bool:
    """Tell whether a program is a regular file of this user, without hard links, that nobody else can write."""
    try:
        found = program.lstat()
    except OSError:
        return False
    return (
        stat.S_ISREG(found.st_mode)
        and found.st_uid == os.geteuid()
        and found.st_nlink == 1
        and not found.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    )


def _above(path: Path) -> Iterator[os.stat_result]:
    """Yield the status of each parent folder and link, of the path as given and as resolved."""
    for way in (Path(os.path.abspath(path)), path.resolve()):  # noqa: PTH100 - links are not to be followed
        for folder_above in way.parents:
            yield folder_above.lstat()


def _is_safe(found: os.stat_result) -> bool:
    if found.st_uid not in {0, os.geteuid()}:
        return False
    writable = found.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    return stat.S_ISLNK(found.st_mode) or not writable or bool(found.st_mode & stat.S_ISVTX)


@functools.cache
def _of_this_run() -> tempfile.TemporaryDirectory[str]:
    """Return a folder with mode 0700 that exists as long as the process."""
    return tempfile.TemporaryDirectory(prefix="keymint-")
