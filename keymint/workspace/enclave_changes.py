# SPDX-License-Identifier: Apache-2.0
"""Plan what changes with the enclaves: the files that all share, and the removal of an enclave."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import field, replace
from pathlib import Path

from comarmor.values import dataclass
from keymint.api import Artifact, BuildType
from keymint.errors import KeymintError
from keymint.names import ROOT, subject_of
from keymint.store.changes import Action, File, FolderChange, Step, folder_changes
from keymint.workspace.installed_enclaves import CERTIFICATE, INSTALLED, enclave_names, files_in
from keymint.workspace.package_build_types import recorded_build_types
from keymint.workspace.session import Session


@dataclass(frozen=True, slots=True)
class EnclaveChanges:
    """What a run does to the enclaves.

    Attributes:
        changed: build types and files of each enclave that changes, by package.
        removed: the packages whose enclaves are removed; they are no example for the others.
    """

    changed: Mapping[str, tuple[Collection[str], Mapping[str, Artifact]]] = field(default_factory=dict)
    removed: frozenset[str] = frozenset()

    def kept(self, session: Session) -> list[str]:
        """Return the packages whose installed enclaves stay as they are."""
        return [name for name in enclave_names(session) if name not in self.removed and name not in self.changed]


NO_CHANGES = EnclaveChanges()


def build_types_in_use(session: Session, changes: EnclaveChanges = NO_CHANGES) -> list[str]:
    """Return the names of the build types that all enclaves have after some changes, sorted."""
    of_packages = [
        *(of_package for of_package, _ in changes.changed.values()),
        *(recorded_build_types(session, name) for name in changes.kept(session)),
    ]
    return sorted({build_type for of_package in of_packages for build_type in of_package})


def shared_steps(session: Session, by_type: Iterable[Mapping[str, Artifact]]) -> list[Step]:
    """Return the steps that write the shared files of each build type, which :func:`shared_copies` returns."""
    steps = []
    for copies in by_type:
        files = {path: File(each.content, secret=each.secret, replaces_link=True) for path, each in copies.items()}
        written = folder_changes(session.tree, session.workspace.install, files)
        if written:
            existed = any(session.tree.read(session.workspace.install / path) for path in files)
            action = Action.UPDATED if existed else Action.CREATED
            steps.append(Step(INSTALLED, "", action, written, "shared by all enclaves"))
    return steps


def obsolete_steps(session: Session, by_type: Iterable[Mapping[str, Artifact]], steps: Iterable[Step]) -> list[Step]:
    """Return the step that removes copies which are none any more, e.g. that of one authority in place of two.

    A file is a former copy by its path, or a second name of what a copy was; one that a link leads to stays.

    Args:
        session: the workspace and its profile.
        by_type: the shared files of each build type, as they will be.
        steps: the steps of the run.
    """
    tree, install = session.tree, session.workspace.install
    written = {f"{change.folder}/{file}" for each in steps for change in each.changes for file in change.written}
    copies = {str(install / path): each for found in by_type for path, each in found.items()}
    folders = {path.rpartition("/")[0] for path in copies} - {str(session.enclaves)} if written else ()
    strays = {f"{folder}/{entry}" for folder in folders for entry, is_folder in tree.names(folder) if not is_folder}
    if not strays - copies.keys():
        return []
    former = {str(install / path): each for found in shared_copies(session, NO_CHANGES) for path, each in found.items()}
    strays -= copies.keys() | {tree.follows(path) for path, _ in tree.walk(install) if path not in written}
    contents = {each.content for each in former.values()} - {each.content for each in copies.values()}
    gone = [Path(path) for path in sorted(strays) if path in former or tree.try_read(path) in contents]
    removed = tuple(FolderChange(path.parent, removed=(path.name,)) for path in gone)
    return [Step(INSTALLED, "", Action.REMOVED, removed, "shared by all enclaves before")] if removed else []


def shared_copies(session: Session, changes: EnclaveChanges) -> list[Mapping[str, Artifact]]:
    """Return the shared files of each build type by path relative to the install space, after some changes."""
    build_types = build_types_in_use(session, changes)
    copied = {file for name in build_types for file in session.plugins.build_type(name).COPIED}
    enclaves: dict[str, Mapping[str, Artifact]] = {}
    contents: dict[str | None, Artifact | None] = {None: None}  # enclaves usually have the same files
    for name in sorted((*changes.changed, *changes.kept(session))):
        if name in changes.changed:
            enclaves[subject_of(name)] = changes.changed[name][1]
            continue
        existing = {file: _artifact(session, f"{session.enclave_folder(name)}/{file}", contents) for file in copied}
        enclaves[subject_of(name)] = {file: each for file, each in existing.items() if each and each.content}
    return [copies_of(session, session.plugins.build_type(name), enclaves) for name in build_types]


def _artifact(session: Session, path: str, contents: dict[str | None, Artifact | None]) -> Artifact | None:
    """Return an installed file, or None if there is none or it cannot be read; equal files are read once."""
    try:
        value = session.tree.digest(path)
        if value not in contents:
            contents[value] = Artifact(session.tree.read(path) or b"")
        return contents[value]
    except KeymintError:
        return None


def copies_of(
    session: Session, build_type: BuildType, enclaves: Mapping[str, Mapping[str, Artifact]]
) -> Mapping[str, Artifact]:
    """Return the copies that a build type has outside of the enclaves, by path relative to the install space.

    Args:
        session: the workspace and its profile.
        build_type: the build type.
        enclaves: files of all enclaves, by subject and name.
    """
    own = {
        subject: {file: files[file] for file in build_type.COPIED if file in files}
        for subject, files in enclaves.items()
    }
    return build_type.shared(own, session.profile.layout)


def withdraw(session: Session, name: str, reason: str, changes: EnclaveChanges) -> Step:
    """Return the step for a subject whose key must not be certified again: no robot may get its enclave.

    Args:
        session: the workspace and its profile.
        name: the package.
        reason: why its certificate was revoked.
        changes: what the run does to the enclaves; it removes this one.
    """
    if name in enclave_names(session):
        return replace(removal_step(session, name, changes), detail=f"revoked: {reason}")
    detail = f"revoked: {reason}; 'keymint renew --rekey {name}' makes a new key"
    return Step(INSTALLED, name, Action.KEPT, detail=detail)


def removal_step(session: Session, name: str, changes: EnclaveChanges) -> Step:
    """Return the step that removes the enclave of a package."""
    folder = session.enclave(name)
    files = files_in(session, name)
    if name == ROOT:  # its folder keeps what the other enclaves share
        copies = shared_copies(session, changes)
        shared = {session.workspace.install / path for of_type in copies for path in of_type}
        files = tuple(file for file in files if folder / file not in shared)
    # The certificate goes last, so that what a killed run leaves is still recognised as an enclave.
    ordered = tuple(sorted(files, key=lambda entry: entry == CERTIFICATE))
    return Step(INSTALLED, name, Action.REMOVED, (FolderChange(folder, removed=ordered),))
