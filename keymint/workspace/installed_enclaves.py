# SPDX-License-Identifier: Apache-2.0
"""The installed enclaves: their names, files and certificates.

At the end, what changes with them: the files that all share, and the removal of an enclave.
"""

from __future__ import annotations

import stat
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import Path

from cryptography import x509

from comarmor.values import Data, field, replace
from keymint.api import Artifact, BuildType
from keymint.errors import Diagnostic, KeymintError, Origin
from keymint.names import ROOT, subject_of
from keymint.pki import certificates
from keymint.store.changes import Action, File, FolderChange, Step, file_mode, folder_changes
from keymint.view.stamps import Stamp
from keymint.view.tree import Tree
from keymint.workspace.package_build_types import recorded_build_types
from keymint.workspace.session import Inputs, Session, once
from keymint.workspace.workspace import hidden_by

CERTIFICATE, KEY = "cert.pem", "key.pem"
INSTALLED = "install"
"""Key of the record of installed enclaves."""
SCRIPT_MARK = "# Written by Keymint."
"""The beginning of each script of a keystore, by which it is recognised."""


@once
def enclave_names(session: Session) -> tuple[str, ...]:
    """Return the names of the installed enclaves, sorted."""
    found = _enclave_names(session.tree, str(session.enclaves), "")
    has_root = session.enclaves != session.workspace.install
    return tuple(sorted(name or ROOT for name in found if name or has_root))


def _enclave_names(tree: Tree, folder: str, name: str) -> Iterator[str]:
    """Yield the name of a folder, empty for the outermost, if it has files of an enclave, and of those below it.

    A function inside of another one would keep the view of all files until cycles are searched.
    """
    entries = tree.names(folder)
    if any(entry in {KEY, CERTIFICATE} for entry, is_folder in entries if not is_folder):
        yield name
    for entry, is_folder in entries:
        if is_folder and not entry.startswith("."):
            yield from _enclave_names(tree, f"{folder}/{entry}", f"{name}/{entry}" if name else entry)


def with_sources(session: Session) -> tuple[str, ...]:
    """Return the names of the installed enclaves that have a source package, sorted."""
    known = frozenset(session.packages())
    return tuple(name for name in enclave_names(session) if name in known)


def orphans(session: Session) -> tuple[str, ...]:
    """Return the installed enclaves without a source package, sorted, except those that KEYMINT_IGNORE hides."""
    return tuple(name for name, marker in unknown_enclaves(session) if marker is None)


def hidden(session: Session) -> tuple[str, ...]:
    """Return the installed enclaves whose source packages a KEYMINT_IGNORE hides, sorted."""
    return tuple(name for name, marker in unknown_enclaves(session) if marker is not None)


def unknown_enclaves(session: Session) -> Iterator[tuple[str, Path | None]]:
    """Yield the installed enclaves without a visible source package, each with the marker that hides the package."""
    src, known = session.workspace.src, set(session.packages())
    for name in enclave_names(session):
        if name not in known:
            yield name, hidden_by(session.tree, src, name)


def require_sources(inputs: Inputs) -> None:
    """Require a source space; without one every enclave would count as orphaned.

    Raises:
        KeymintError: there is none.
    """
    src = inputs.workspace.src
    if inputs.tree.status(src) is None and not inputs.tree.names(src):
        message = "there is no source space, so it is unknown which enclaves are orphaned"
        help_ = "set it with --src-space, or create it to remove all enclaves"
        raise KeymintError(message, where=inputs.workspace.origin(src), help=help_, code="sources-missing")


def files_in(session: Session, name: str) -> tuple[str, ...]:
    """Return the names of the files of an enclave, sorted.

    The folder of the root enclave has those that all enclaves share as well: there, a file is the enclave's if a build
    type has one of that name, and a certificate or a key shows that there is an enclave.

    Raises:
        KeymintError: the folder cannot be read.
    """
    found = tuple(file for file, is_folder in session.tree.names(session.enclave_folder(name)) if not is_folder)
    if name != ROOT:
        return found
    if KEY not in found and CERTIFICATE not in found:
        return ()
    build_types = map(session.plugins.build_type, session.plugins.names("keymint.build_types"))
    known = {file for each in build_types for file in each.files(session.profile.layout)}
    return tuple(file for file in found if file in known)


@once
def enclave_files(session: Session, name: str) -> tuple[Mapping[str, bytes], tuple[Diagnostic, ...]]:
    """Return the files of a package's enclave by name, and a finding for each that cannot be read."""
    files: dict[str, bytes] = {}
    unreadable: list[Diagnostic] = []
    folder = session.enclave_folder(name)
    try:
        entries = files_in(session, name)
    except KeymintError as error:
        return {}, tuple(replace(each, subject=subject_of(name)) for each in error.diagnostics)
    for file in entries:
        path = f"{folder}/{file}"
        try:
            if (content := session.tree.read(path)) is not None:
                files[file] = content
        except KeymintError as error:
            where = session.workspace.origin(path)
            unreadable += (
                replace(each, where=where, help=each.help or "remove it", subject=subject_of(name))
                for each in error.diagnostics
            )
    return files, tuple(unreadable)


def enclave_digests(session: Session, name: str) -> dict[str, str] | None:
    """Return the digests of :func:`enclave_files`; None if a file cannot be read."""
    folder = session.enclave_folder(name)
    try:
        found = {file: session.tree.digest(f"{folder}/{file}") for file in files_in(session, name)}
    except KeymintError:
        return None
    return {file: value for file, value in found.items() if value is not None}


def not_installed(name: str, folder: str, revoked: str = "") -> Diagnostic:
    """Return the finding on a package without an enclave.

    Args:
        name: the package.
        folder: the missing folder as messages show it.
        revoked: why its certificate was revoked; empty if it was not.
    """
    if revoked:
        message = f"the certificate of {subject_of(name)} was revoked ({revoked}), and its enclave removed"
        help_ = f"'keymint renew --rekey {name}' makes a new key and certificate"
        return Diagnostic.note("identity-revoked", message, None, help_, subject_of(name))
    message, help_ = f"the enclave {subject_of(name)} is not installed", f"run 'keymint install {name}'"
    return Diagnostic.error("enclave-missing", message, Origin(folder), help_, subject_of(name))


@once
def deployed_authorities(session: Session) -> tuple[x509.Certificate, ...]:
    """Return the certificates of authorities that the installed enclaves trust, each once.

    Files that cannot be read or contain no certificates are skipped.
    """
    contents: dict[bytes, None] = {}
    for name in enclave_names(session):
        for entry, is_folder in session.tree.names(session.enclave(name)):
            if not is_folder and entry.endswith(".pem") and entry not in {CERTIFICATE, KEY}:
                contents[session.tree.try_read(session.enclave(name) / entry) or b""] = None
    return tuple(dict.fromkeys(certificate for pem in contents for certificate in _certificates(pem)))


def installed_certificate(session: Session, name: str) -> x509.Certificate | None:
    """Return the identity certificate of an installed enclave, or None if there is no readable one."""
    pem = session.tree.try_read(f"{session.enclave_folder(name)}/{CERTIFICATE}")
    return next(_certificates(pem or b""), None)


def _certificates(pem: bytes) -> Iterator[x509.Certificate]:
    try:
        for certificate in certificates.load_bundle(pem) if pem else ():
            certificates.public_key(certificate)
            yield certificate
    except KeymintError:
        return


def has_mode(inputs: Inputs, path: Path | str, *, secret: bool) -> bool:
    """Tell whether an installed file has its mode, or does not exist."""
    status = inputs.tree.status(path)
    return status is None or stat.S_IMODE(status.st_mode) & 0o777 == file_mode(secret=secret)


def new_files(
    inputs: Inputs, folder: Path, existing: Mapping[str, bytes], files: Mapping[str, File]
) -> dict[str, File]:
    """Return the files that a folder does not have yet, with their content and their mode."""
    return {
        path: file
        for path, file in files.items()
        if existing.get(path) != file.content or not has_mode(inputs, folder / path, secret=file.secret)
    }


def has_outputs(inputs: Inputs, folder: str, stamp: Stamp) -> bool:
    """Tell whether the files of a stamp in a folder are as they were installed; none is if it cannot be read."""
    try:
        return all(
            inputs.tree.digest(f"{folder}/{file}") == value
            and has_mode(inputs, f"{folder}/{file}", secret=file in stamp.secret)
            for file, value in stamp.outputs.items()
        )
    except KeymintError:
        return False


# -- changes -----------------------------------------------------------------------------------------------------------


class EnclaveChanges(Data):
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


def shared_steps(session: Session, by_type: Iterable[Mapping[str, Artifact]], changes: EnclaveChanges) -> list[Step]:
    """Return the steps that write the shared files of each build type, which :func:`shared_copies` returns.

    One that an enclave has by a link, and goes on to have so, stays: the enclave would change with it.
    """
    steps = []
    for copies in by_type:
        files = {path: File(each.content, secret=each.secret, replaces_link=True) for path, each in copies.items()}
        written = folder_changes(session.tree, session.workspace.install, files)
        if written and (linked := set(_linked(session, changes))):
            files = {path: each for path, each in files.items() if str(session.workspace.install / path) not in linked}
            written = folder_changes(session.tree, session.workspace.install, files)
        if written:
            existed = any(session.tree.read(session.workspace.install / path) for path in files)
            action = Action.UPDATED if existed else Action.CREATED
            steps.append(Step(INSTALLED, "", action, written, "shared by all enclaves"))
    return steps


def _linked(session: Session, changes: EnclaveChanges) -> Iterator[str]:
    """Yield the files that links in enclaves lead to which stay after some changes."""
    for name in frozenset(enclave_names(session)) - changes.removed:
        new = changes.changed[name][1] if name in changes.changed else {}
        for file in files_in(session, name):
            target = session.tree.follows(path := f"{session.enclave_folder(name)}/{file}")
            if target and (file not in new or new[file].content == session.tree.read(path)):
                yield target


def obsolete_steps(session: Session, by_type: Iterable[Mapping[str, Artifact]], steps: Sequence[Step]) -> list[Step]:
    """Return the step that removes copies which are none any more, e.g. that of one authority in place of two.

    A file is a former copy by its path, or a second name of what a copy was; one that a link leads to stays.

    Args:
        session: the workspace and its profile.
        by_type: the shared files of each build type, as they will be.
        steps: the steps of the run.
    """
    tree, install = session.tree, session.workspace.install
    copies = {str(install / path): each for found in by_type for path, each in found.items()}
    folders = {path.rpartition("/")[0] for path in copies} - {str(session.enclaves)}
    folders = folders if any(change.written for each in steps for change in each.changes) else set()
    strays = {f"{folder}/{entry}" for folder in folders for entry, is_folder in tree.names(folder) if not is_folder}
    if not strays - copies.keys():
        return []
    written = {f"{change.folder}/{file}" for each in steps for change in each.changes for file in change.written}
    former = {str(install / path): each for found in shared_copies(session, NO_CHANGES) for path, each in found.items()}
    strays -= copies.keys() | {tree.follows(path) for path, _ in tree.walk(install) if path not in written}
    contents = {each.content for each in former.values()} - {each.content for each in copies.values()}
    gone = [Path(path) for path in sorted(strays) if path in former or tree.try_read(path) in contents]
    removed = tuple(FolderChange(path.parent, removed=(path.name,)) for path in gone)
    return [Step(INSTALLED, "", Action.REMOVED, removed, "shared by all enclaves before")] if removed else []


def is_script(content: bytes) -> bool:
    """Tell whether a file is a script that Keymint wrote, which may have been edited since."""
    return content.startswith(SCRIPT_MARK.encode())


def last_steps(session: Session, changes: EnclaveChanges) -> list[Step]:
    """Return the step that removes what all enclaves share, and the scripts, if some changes leave no enclave."""
    there, tree, install = enclave_names(session), session.tree, session.workspace.install
    if not there or changes.changed or changes.kept(session):
        return []
    own = session.enclave(ROOT) if ROOT in there else None  # its files are removed with it
    shared = {install / path for found in shared_copies(session, NO_CHANGES) for path in found}
    gone = [each for each in shared if tree.has_file(each) and each.parent != own]
    gone += [install / name for name, content in tree.files(install).items() if is_script(content)]
    removed = tuple(FolderChange(path.parent, removed=(path.name,)) for path in sorted(gone))
    return [Step(INSTALLED, "", Action.REMOVED, removed, "shared by all enclaves; none is left")]


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
