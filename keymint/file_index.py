# SPDX-License-Identifier: Apache-2.0
"""Digests of the files of a workspace, kept beside the record, so that files that did not change are not read.

Like the record, the index only saves work: without it, all files are read.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from keymint.changes import File, FolderChange
from keymint.folder_status import NEVER, FolderStatus, folder_status, walk
from keymint.state import MAX_RECORD, sealed, unsealed
from keymint.store import Store
from keymint.tree import Tree, read_file
from keymint.workspace import Workspace
from keymint.workspace_lock import clock

INDEX = "files.json"
"""Name of the index in the folder of records."""
VERSION = 1
Digests = Mapping[str, Mapping[str, str]]
"""Digests of files (see :func:`keymint.state.digest`) by folder and name."""


@dataclass(frozen=True, slots=True)
class Sight:
    """The folders of a workspace as they are before a run reads a file.

    Attributes:
        roots: the folders that were looked at, with all that is below them.
        folders: the status of each folder.
        clock: the clock of the file system before that, in nanoseconds; 0 if it is not known.
    """

    roots: tuple[str, ...]
    folders: Mapping[str, FolderStatus]
    clock: int

    @classmethod
    def of(cls, folders: Iterable[Path], clock: int = 0) -> Sight:
        """Look at folders and all that is below them."""
        roots = tuple(map(str, folders))
        return cls(roots, walk(roots), clock)

    def after(self, written: Digests, removed: Mapping[str, Iterable[str]], clock: int) -> Sight:
        """Return what is there when the run is done.

        The status of a folder in which something else changed meanwhile is not trusted.

        Args:
            written: the files that the run wrote.
            removed: the names of files that it removed, by folder.
            clock: the clock of the file system, later than the last write.
        """
        folders = {
            folder: status if status.is_trusted(self.clock) else status._replace(newest=NEVER)
            for folder, status in self.folders.items()
        }
        for folder in filter(self._has, {*written, *removed, *self._new_above(written)}):
            before, new = self.folders.get(folder), written.get(folder, {})
            present = folder_status(folder, [], new, self.clock)
            if present is None:
                folders.pop(folder, None)
                continue
            kept = set(before.files if before else ()).difference(removed.get(folder, ()))
            folders[folder] = present if {*present.files} == kept.union(new) else present._replace(newest=NEVER)
        return Sight(self.roots, folders, clock)

    def _has(self, folder: str) -> bool:
        return f"{folder}/".startswith(tuple(f"{root}/" for root in self.roots))

    def _new_above(self, folders: Iterable[str]) -> set[str]:
        """Return the folders above new ones that are new as well."""
        new: set[str] = set()
        for folder in folders:
            above = folder if folder in self.roots else folder.rpartition("/")[0]
            while above not in self.folders and above not in new and self._has(above):
                new.add(above)
                above = above.rpartition("/")[0]
        return new


def load(workspace: Workspace, sight: Sight) -> Digests:
    """Return the recorded digests of the files in folders that are as they were when they were recorded.

    Args:
        workspace: the workspace; if its index is missing, damaged or of another version, nothing is known.
        sight: its folders as they are.
    """
    document = unsealed(read_file(workspace.state / INDEX, MAX_RECORD), VERSION)
    known: dict[str, Mapping[str, str]] = {}
    for name, (status, digests) in document["folders"].items() if document else ():
        folder = name if name.startswith("/") else f"{workspace.root}/{name}"
        present = sight.folders.get(folder)
        if present is not None and status == present.digest:
            known[folder] = digests
    return known


def save(store: Store, workspace: Workspace, tree: Tree, sight: Sight, changes: Iterable[FolderChange]) -> None:
    """Write the index after a run, if it changed.

    Args:
        store: the writer.
        workspace: the workspace.
        tree: the files that the run read.
        sight: the folders before that.
        changes: what the run wrote and removed.
    """
    written, removed = _written_by(changes)
    seen = sight.after(written, removed, clock(workspace.state))
    content = _dump(workspace.root, seen, tree.known, tree.digests, written)
    if content != read_file(workspace.state / INDEX, MAX_RECORD):
        store.write(workspace.state, {INDEX: File(content)})


def _dump(root: Path, sight: Sight, *digests: Digests) -> bytes:
    """Return the index; its paths are relative to the root, so that it stays valid if the workspace is moved."""
    folders = {}
    for folder, status in sight.folders.items():
        known = {name: digest for each in digests for name, digest in each.get(folder, {}).items()}
        present = {name: known[name] for name in status.files if name in known}
        if present and status.is_trusted(sight.clock):
            folders[folder.removeprefix(f"{root}/")] = (status.digest, present)
    return sealed({"version": VERSION, "folders": folders})


def _written_by(changes: Iterable[FolderChange]) -> tuple[dict[str, dict[str, str]], dict[str, set[str]]]:
    """Return the digests of the files that changes write, and the names of those that they remove, by folder."""
    written: dict[str, dict[str, str]] = {}
    removed: dict[str, set[str]] = {}
    for change in changes:
        folder = str(change.folder)
        if change.written:
            digests = written.setdefault(folder, {})
            digests.update((name, file.digest) for name, file in change.files.items())
            digests.update((name, file.digest) for name, file in change.held.items())
        if change.removed:
            removed.setdefault(folder, set()).update(change.removed)
    return written, removed
