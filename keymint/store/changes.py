# SPDX-License-Identifier: Apache-2.0
"""Planned changes: the files to write and to remove, by folder, step and plan."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping
from enum import StrEnum
from pathlib import Path

from comarmor.errors import Diagnostic
from comarmor.values import Data, field, replace
from keymint.view.stamps import NO_STAMP, State
from keymint.view.tree import Content, File, HeldPackage, Tree

__all__ = ["Action", "DocumentSize", "File", "FolderChange", "Plan", "Step", "file_mode", "folder_changes"]


class Action(StrEnum):
    """The effect of a step on its package."""

    CREATED = "created"
    UPDATED = "updated"
    UNCHANGED = "unchanged"
    KEPT = "kept"
    REMOVED = "removed"


def file_mode(*, secret: bool) -> int:
    """Return the mode of a secret or public file."""
    return 0o600 if secret else 0o644


class FolderChange(Data):
    """Files to write into one folder, and names to remove from it.

    Attributes:
        folder: absolute path; a text takes less memory and time.
        files: files by name; written in this order, so that a reader meets the least harm in between.
        removed: names of files to remove.
        private: the folder and the ones created on the way to it are 0700 even when no file is secret.
        held: in place of files, the digests of those that another process will write, by name; empty if not known.
    """

    folder: Path | str
    files: Mapping[str, File] = field(default_factory=dict)
    removed: tuple[str, ...] = ()
    private: bool = False
    held: Mapping[str, str] = field(default_factory=dict)

    @property
    def written(self) -> Mapping[str, File | str]:
        """The files that are written, by whichever process, by name."""
        return self.files or self.held


def folder_changes(tree: Tree, folder: Path, files: Mapping[str, File | bytes]) -> tuple[FolderChange, ...]:
    """Return the changes that give a folder these files, without files that already have this content.

    Args:
        tree: the files that are there.
        folder: absolute path.
        files: the files by path relative to the folder; of a public file the content is enough.
    """
    new = {path: file if isinstance(file, File) else File(file) for path, file in files.items()}
    different = {path: file for path, file in new.items() if tree.read(f"{folder}/{path}") != file.content}
    return tuple(FolderChange(inner, own) for inner, own in by_folder(folder, different).items())


def same_file(known: dict[str, File], name: str, content: bytes) -> File:
    """Return a file that may replace a link: the former one of a name if it has the same content, and so the digest.

    Args:
        known: the former file of each name.
        name: its name.
        content: its content.
    """
    file = known.get(name)
    if file is None or file.content is not content:
        file = known[name] = File(content, replaces_link=True)
    return file


def secret_file(path: Path | str, content: bytes | Callable[[], Iterable[bytes]]) -> FolderChange:
    """Return the change that writes one secret file; its content may be made late, as that of a :class:`File`."""
    folder, _, name = str(path).rpartition("/")
    return FolderChange(folder, {name: File(content, secret=True)}, private=True)


def by_folder(root: Path, files: Mapping[str, File]) -> dict[Path, dict[str, File]]:
    """Return files, given by path relative to a folder, by the folder that each lies in."""
    folders: dict[str, dict[str, File]] = {}
    for path, file in files.items():
        inner, _, name = path.rpartition("/")
        folders.setdefault(inner, {})[name] = file
    return {root / inner if inner else root: own for inner, own in folders.items()}


class DocumentSize(Data):
    """Bytes of a document that was rewritten into a smaller one, and of the plain document."""

    file: str
    bytes: int
    plain_bytes: int


class HeldChanges(HeldPackage):
    """The changes of a package that another process holds; they are made as they are asked for."""

    __slots__ = ()

    def __iter__(self) -> Iterator[FolderChange]:
        for around, names, private in self.places:
            yield FolderChange(f"{around}{self.name}", {}, (), private, dict.fromkeys(names, ""))

    def __len__(self) -> int:
        return len(self.places)


class Step(Data):
    """What one stage does for one package, or for the workspace as a whole (empty name).

    Attributes:
        stage: the stage.
        package: the package.
        action: what becomes of it.
        changes: what is written and removed.
        detail: a few more words for the user.
        sizes: of the documents that were built, those that may be rewritten.
    """

    stage: str
    package: str
    action: Action
    changes: tuple[FolderChange, ...] | HeldChanges = ()
    detail: str = ""
    sizes: tuple[DocumentSize, ...] = ()

    def writes(self) -> bool:
        """Tell whether anything is written."""
        return isinstance(self.changes, HeldChanges) or any(each.written or each.removed for each in self.changes)


class Plan(Data):
    """All steps of a run, its diagnostics, and the record to keep when it is done.

    Attributes:
        first: what is durable before anything else is visible: the register of the certificates that the run issues.
    """

    steps: tuple[Step, ...]
    state: State
    diagnostics: tuple[Diagnostic, ...] = ()
    first: tuple[FolderChange, ...] = ()

    def then(self, other: Plan) -> Plan:
        """Return this plan followed by one that was made on top of it."""
        return Plan(
            self.steps + other.steps, other.state, self.diagnostics + other.diagnostics, self.first + other.first
        )

    def noting(self, *diagnostics: Diagnostic) -> Plan:
        """Return this plan with further diagnostics."""
        return replace(self, diagnostics=(*self.diagnostics, *diagnostics))

    def of_action(self, *actions: Action) -> frozenset[str]:
        """Return the packages with a step that has one of some actions."""
        return frozenset(step.package for step in self.steps if step.action in actions)

    def changes(self) -> Iterator[FolderChange]:
        """Yield all changes, in order, but those of :meth:`held`: another process writes these."""
        own = (step.changes for step in self.steps if not isinstance(step.changes, HeldChanges))
        return itertools.chain(self.first, itertools.chain.from_iterable(own))

    def names(self) -> Iterator[tuple[str, Iterable[str], Iterable[str]]]:
        """Yield the folder of each change, with the names of the files that are written there, and removed."""
        for change in self.changes():
            yield str(change.folder), change.written, change.removed
        for held in self.held():
            for around, names, _ in held.places:
                yield f"{around}{held.name}", names, ()

    def held(self) -> Iterator[HeldChanges]:
        """Yield the packages that another process holds, of which little is kept."""
        return (step.changes for step in self.steps if isinstance(step.changes, HeldChanges))

    def overlay(self, below: str = "") -> list[tuple[str, Mapping[str, Content]]]:
        """Return the planned content by folder and name, without :meth:`held`, for the stages that plan on top of it.

        Args:
            below: if given, a folder with a slash at its end; only the content of it and of its subfolders is returned.
        """
        return [
            (
                str(change.folder),
                {**change.written, **dict.fromkeys(change.removed)} if change.removed else change.written,
            )
            for changes in (self.first, *(step.changes for step in self.steps))
            for change in (() if isinstance(changes, HeldChanges) else changes)
            if f"{change.folder}/".startswith(below)
        ]

    def carried_out(self, *stages: str) -> Plan:
        """Return the plan without what is written and takes memory: the content of what comes first, and the record.

        Args:
            stages: of these the record stays.
        """
        first = (FolderChange(each.folder, held=dict.fromkeys(each.files, "")) for each in self.first)
        for each in self.held():  # only a stage asks for digests
            each.stamp = NO_STAMP
        state = State({name: self.state.stamps.get(name, {}) for name in stages})
        return replace(self, state=state, first=tuple(first))

    def writes(self) -> bool:
        """Tell whether anything is written."""
        return bool(self.first) or any(step.writes() for step in self.steps)
