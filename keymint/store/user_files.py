# SPDX-License-Identifier: Apache-2.0
"""Write files of the user: each beside its target as ``.NAME.keymint-part``, which takes its place once it is complete.

Such a file is new, 0600 and locked. What a killed run left has no lock; the next run for this target removes it.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

from keymint.store.changes import File
from keymint.store.file_writing import FILE, NEW_FILE, fill, open_at, reported, require_regular
from keymint.store.open_folders import OpenFolders, Roots
from keymint.store.store import wait_for_lock


def write_files(
    root: Path, files: Mapping[Path, File], on_wait: Callable[[str], None], wanted: Mapping[Path, File] | None = None
) -> None:
    """Replace files in their order, each in one step, after all of them are written beside.

    Args:
        root: the folder that they lie in, or in whose subfolders, which are created.
        files: new content by absolute path.
        on_wait: called before waiting for another process that writes one of them, with that process in words.
        wanted: further files, which are right; what a killed run left beside them is removed, too.

    Raises:
        KeymintError: a link or another kind of file is in the way, or the system refuses. Then nothing is replaced, but
            for those before the one that is refused.
    """
    with OpenFolders(Roots({root: False}, root)) as folders:
        for path in (wanted or {}).keys() - files.keys():
            with reported(path):
                _remove_left_over(folders.open(str(path.parent)), _part(path), on_wait)
        with contextlib.ExitStack() as parts:
            for path, file in files.items():
                parts.enter_context(_written(folders, path, file, on_wait))
            for path in files:
                with reported(path):
                    opened = folders.open(str(path.parent))
                    os.rename(_part(path), path.name, src_dir_fd=opened, dst_dir_fd=opened)
            for folder in {path.parent for path in files}:
                folders.sync(str(folder))


def _part(path: Path) -> str:
    return f".{path.name}.keymint-part"


@contextlib.contextmanager
def _written(folders: OpenFolders, path: Path, file: File, on_wait: Callable[[str], None]) -> Iterator[None]:
    """Write a file beside its place; it is removed after an error."""
    folder, name = folders.open(str(path.parent)), _part(path)
    replaced = require_regular(folder, path.parent, path.name)
    with reported(path):
        opened = _created(folder, name, on_wait)
    try:
        with reported(path):
            fill(opened, file, (replaced.st_uid, replaced.st_gid) if replaced else None)
            os.fsync(opened)
        yield
    except BaseException:
        with contextlib.suppress(OSError):
            os.unlink(name, dir_fd=folders.open(str(path.parent)))
        raise
    finally:
        os.close(opened)


def _created(folder: int, name: str, on_wait: Callable[[str], None]) -> int:
    """Return a new file that is locked."""
    while True:
        _remove_left_over(folder, name, on_wait)
        with contextlib.suppress(FileExistsError):
            opened = os.open(name, NEW_FILE, 0o600, dir_fd=folder)
            try:
                wait_for_lock(opened, fcntl.LOCK_EX, on_wait)
                if _is_named(opened, folder, name):
                    return opened
            except BaseException:
                os.unlink(name, dir_fd=folder)
                os.close(opened)
                raise
            os.close(opened)


def _remove_left_over(folder: int, name: str, on_wait: Callable[[str], None]) -> None:
    """Remove a file once nobody holds its lock."""
    with contextlib.suppress(FileNotFoundError), open_at(name, folder, FILE | os.O_RDWR) as opened:
        wait_for_lock(opened, fcntl.LOCK_EX, on_wait)
        if _is_named(opened, folder, name):
            os.unlink(name, dir_fd=folder)


def _is_named(opened: int, folder: int, name: str) -> bool:
    """Tell whether an open file still has its name: another process may have removed or renamed it."""
    try:
        return os.path.samestat(os.fstat(opened), os.lstat(name, dir_fd=folder))
    except FileNotFoundError:
        return False
