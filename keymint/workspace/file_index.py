# SPDX-License-Identifier: Apache-2.0
"""Digests of the files of a workspace, kept beside the record, so that files that did not change are not read.

Like the record, the index only saves work: without it, all files are read.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

from keymint.store.changes import File, FolderChange
from keymint.store.store import Store
from keymint.store.workspace_lock import clock
from keymint.view.folder_status import Sight
from keymint.view.stamps import MAX_RECORD, sealed, unsealed
from keymint.view.tree import Tree, read_file
from keymint.workspace.workspace import Workspace

INDEX = "files.json"
"""Name of the index in the folder of records."""
VERSION = 1
Digests = Mapping[str, Mapping[str, str]]
"""Digests of files (see :func:`keymint.view.stamps.digest`) by folder and name."""


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


def save(
    store: Store, workspace: Workspace, tree: Tree, sight: Sight, changes: Iterable[FolderChange], visible: int
) -> Sight:
    """Write the index after a run, if it changed.

    Args:
        store: the writer.
        workspace: the workspace.
        tree: the files that the run read.
        sight: the folders before that.
        changes: what the run wrote and removed.
        visible: the clock of the file system before that became visible.

    Returns:
        The folders after the run.
    """
    written, removed = _written_by(changes)
    seen = sight.after(written, removed, visible, clock(workspace.state))
    content = _dump(workspace.root, seen, *tree.digests, written)
    if content != read_file(workspace.state / INDEX, MAX_RECORD):
        store.write(workspace.state, {INDEX: File(content)})
    return seen


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
            digests = {name: file.digest for name, file in change.written.items()}
            written.setdefault(folder, {}).update(digests)
        if change.removed:
            removed.setdefault(folder, set()).update(change.removed)
    return written, removed
