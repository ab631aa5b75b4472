# SPDX-License-Identifier: Apache-2.0
"""Documents in the build space: which there are, and whether they are as they were built, or edited by hand.

They are those of a package, or those over all packages of a build type; the name of the latter is the key of their
record (:func:`keymint.workspace.package_build_types.record_key`).

The stages treat the latter as one more package. But many packages give their content, one signer signs it, and they lie
outside of the enclaves. They are written before any enclave: rights of a new subject admit nobody until its enclave is
there, and the rights of a removed subject end before anything else changes.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

from comarmor.text import lazy_regex
from keymint import api
from keymint.authority.authorities import Authorities
from keymint.authority.authority_files import trusted_chains
from keymint.errors import Diagnostic, KeymintError
from keymint.names import subject_of
from keymint.stages.identities import Signers, authority_of
from keymint.stages.work import PackagePlan
from keymint.store.changes import Action, File, FolderChange, Step, by_folder
from keymint.view.stamps import Stamp, digest, digest_files
from keymint.workspace.installed_enclaves import INSTALLED, enclave_files, enclave_names
from keymint.workspace.package_build_types import BUILD, SHARED, load_packages, record_key, shared_type, users
from keymint.workspace.session import Inputs, Session, once
from keymint.workspace.workspace import with_place

OUTDATED, HAND_EDITED = "build-outdated", "hand-edited"
"""Codes of the diagnostics on stale builds and on documents that a person edited."""


def documents_folder(inputs: Inputs, name: str) -> Path:
    """Return the folder of the unsigned documents of a package, or of those over all packages."""
    return inputs.workspace.build / (SHARED if shared_type(name) else name)


def is_built(inputs: Inputs, name: str) -> bool:
    """Tell whether a package was built and has its documents; a package whose rights are shared has none of its own."""
    return document_digests(inputs, name) is not None


def document_digests(inputs: Inputs, name: str) -> dict[str, str] | None:
    """Return the digests of :func:`built_documents`; None if not built, or if one over all packages is missing."""
    stamp, folder = inputs.state.stamp(BUILD, name), documents_folder(inputs, name)
    if stamp is None:
        found = {file: digest(content) for file, content in built_documents(inputs, name).items()}
        return found or None
    digests = {file: inputs.tree.digest(f"{folder}/{file}") for file in sorted(stamp.outputs)}
    found = {file: value for file, value in digests.items() if value is not None}
    is_there = len(found) == len(digests) if shared_type(name) else found or not digests
    return found if is_there else None


def built_documents(inputs: Inputs, name: str) -> dict[str, bytes]:
    """Return the unsigned documents of a package by file name; empty if it was not built."""
    stamp, folder = inputs.state.stamp(BUILD, name), documents_folder(inputs, name)
    if stamp is None:
        return {} if shared_type(name) else inputs.tree.files(folder)
    contents = {file: inputs.tree.read(f"{folder}/{file}") for file in sorted(stamp.outputs)}
    return {file: content for file, content in contents.items() if content is not None}


def kept_documents_step(inputs: Inputs, name: str, stamp: Stamp) -> Step | None:
    """Return the step for documents that need no build, edited or not; None if one is missing.

    Args:
        inputs: the workspace.
        name: the package, or the key of shared documents.
        stamp: the record of the documents.
    """
    folder, package = documents_folder(inputs, name), "" if shared_type(name) else name
    digests = {file: inputs.tree.digest(f"{folder}/{file}") for file in stamp.outputs}
    if None in digests.values():
        return None
    if edited := [file for file, value in digests.items() if value != stamp.outputs[file]]:
        return Step(BUILD, package, Action.KEPT, detail=f"{', '.join(edited)} edited by hand; -f rebuilds")
    return Step(BUILD, package, Action.UNCHANGED, detail="" if package else ", ".join(stamp.outputs))


def refuse_edits(inputs: Inputs, name: str, existing: Mapping[str, bytes | None]) -> None:
    """Refuse to replace a document that is not the recorded build.

    Args:
        inputs: the workspace.
        name: the package, or the key of shared documents.
        existing: the present content of the documents that would change; None for one that does not exist.

    Raises:
        KeymintError: a person edited one, or it is from elsewhere.
    """
    for file, content in existing.items():
        if content is None or inputs.state.wrote(BUILD, name, file, content):
            continue
        where = inputs.workspace.origin(documents_folder(inputs, name) / file)
        message, help_, code = "was edited by hand, so nothing is built in its place", "discards the edit", HAND_EDITED
        if not shared_type(name) and inputs.state.stamp(BUILD, name) is None:
            message = "is not from a build of this workspace, and differs from what its sources give"
            help_, code = "replaces it", "build-foreign"
        raise KeymintError(message, where=where, help=f"{_rebuild(name)} {help_}", code=code)


def edits(inputs: Inputs, name: str, documents: Mapping[str, bytes]) -> Iterator[Diagnostic]:
    """Yield a warning for each document that is signed although it differs from the built one.

    Args:
        inputs: the workspace.
        name: the package, or the key of shared documents.
        documents: the documents that are signed.
    """
    message, help_ = "was edited by hand; signing the edited document", f"{_rebuild(name)} discards the edit"
    subject = "" if shared_type(name) else subject_of(name)
    for file, content in documents.items():
        if not inputs.state.wrote(BUILD, name, file, content):
            where = inputs.workspace.origin(documents_folder(inputs, name) / file)
            yield Diagnostic.warning(HAND_EDITED, message, where, help_, subject)


def _rebuild(name: str) -> str:
    return "'keymint build -f'" if shared_type(name) else f"'keymint build -f {name}'"


# -- documents over all packages ---------------------------------------------------------------------------------------

_PATH = lazy_regex(r"[A-Za-z0-9_][A-Za-z0-9_.-]*(?:/[A-Za-z0-9_][A-Za-z0-9_.-]*)*")


def build_shared(session: Session, name: str, options: api.BuildOptions) -> api.BuildResult:
    """Return the shared documents of a build type.

    Args:
        session: the workspace and its profile.
        name: name of the build type.
        options: options of the build.

    Raises:
        KeymintError: a package has defects, or packages contradict each other.
        ValueError: the build type breaks the rules for paths.
    """
    builder = session.plugins.build_type(name)
    result = builder.build_shared(load_packages(session, name), options)
    layout = builder.LAYOUTS[session.profile.layout]
    for path in result.documents:
        if not _PATH.fullmatch(path) or (layout.enclaves and f"{path}/".startswith(f"{layout.enclaves}/")):
            raise ValueError(f"{name} has a shared document with an illegal path: {path!r}")
    return result


def sign_shared(
    session: Session, name: str, documents: Mapping[str, bytes], authorities: Authorities
) -> tuple[Mapping[str, api.Artifact], Mapping[str, bytes]]:
    """Return the files of shared documents to install by path relative to the install space, and the present ones.

    Args:
        session: the workspace and its profile.
        name: name of the build type.
        documents: its unsigned documents.
        authorities: the authorities that sign, by name.

    Raises:
        KeymintError: a package has defects, or an authority or the documents cannot sign or be signed.
        ValueError: the build type installs a file that belongs to none of the documents.
    """
    build_type = session.plugins.build_type(name)
    loaded, chains = load_packages(session, name), trusted_chains(session)
    roles = {
        role: [(each, authority_of(authorities, each.name, each.origin)) for each in of_role]
        for role, of_role in shared_roles(loaded, build_type).items()
    }
    credentials = api.Credentials(
        {role: b"".join(dict.fromkeys(chains[wanted.name] for wanted, _ in each)) for role, each in roles.items()},
        Signers({role: minted for role, each in roles.items() for wanted, minted in each if wanted.signs}),
    )
    existing = installed_shared(session, documents)
    try:
        artifacts = build_type.install_shared(loaded, documents, credentials, session.profile.layout, existing)
    except KeymintError as error:
        folder = documents_folder(session, record_key(name))
        # Build types name these documents relative to the folder that has them; a key has a path of its own.
        raise KeymintError.of(
            with_place(each, folder) if each.where and each.where.file in documents else each
            for each in error.diagnostics
        ) from error
    if foreign := [path for path in artifacts if not _belongs(path, documents)]:
        raise ValueError(f"{name} installs {foreign[0]!r}, which belongs to none of its shared documents")
    return artifacts, existing


def shared_roles(
    loaded: Iterable[api.Package], build_type: api.BuildType
) -> Mapping[str, tuple[api.AuthorityRole, ...]]:
    """Return the authorities that packages have in each role, each name once.

    Raises:
        KeymintError: two packages have different authorities in a role that signs.
    """
    roles: dict[str, dict[str, api.AuthorityRole]] = {}
    for package in loaded:
        for role in build_type.authorities(package):
            of_role = roles.setdefault(role.role, {})
            of_role.setdefault(role.name, role)
            first = next(iter(of_role.values()))
            if role.signs and role.name != first.name:
                raise KeymintError(
                    f"{package.subject} has the authority {role.name!r} in the role {role.role!r}, another package "
                    f"has {first.name!r} ({first.origin}), but the shared documents have one signer",
                    where=role.origin,
                    help="name the same authority in all packages",
                    code="authority-mismatch",
                )
    return {name: tuple(of_role.values()) for name, of_role in roles.items()}


def obsolete_documents(session: Session, stage: str, folder: Path) -> Iterator[PackagePlan]:
    """Yield what removes the documents of build types that no package has any more.

    Args:
        session: the workspace and its profile.
        stage: the stage that recorded them.
        folder: the folder that the recorded paths are relative to.
    """
    recorded = session.state.stamps.get(stage, {})
    for key in recorded:
        build_type = shared_type(key)
        if build_type and build_type not in users(session):
            changes = removals(session, folder, recorded[key].outputs)
            yield PackagePlan(key, Step(stage, "", Action.REMOVED, changes, f"shared documents of {build_type}"))


def removals(session: Session, folder: Path, paths: Iterable[str]) -> tuple[FolderChange, ...]:
    """Return the changes that remove files, given by path relative to a folder; missing ones are skipped."""
    existing = [path for path in sorted(paths) if session.tree.has_file(folder / path)]
    folders = by_folder(folder, dict.fromkeys(existing, File(b"")))
    return tuple(FolderChange(parent, removed=tuple(names)) for parent, names in folders.items())


# -- what is installed -------------------------------------------------------------------------------------------------


def installed_shared(session: Session, documents: Iterable[str]) -> dict[str, bytes]:
    """Return the installed files that belong to shared documents, by path relative to the install space.

    Args:
        session: the workspace and its profile.
        documents: paths of the documents; a file belongs to one if it has its path, perhaps with a suffix.

    Raises:
        KeymintError: a file cannot be read.
    """
    found: dict[str, bytes] = {}
    install = session.workspace.install
    for document in documents:
        path = install / document
        for entry, is_folder in session.tree.names(path.parent):
            if not is_folder and _belongs(entry, [path.name]):
                content = session.tree.read(path.parent / entry)
                if content is not None:
                    found[str((path.parent / entry).relative_to(install))] = content
    return found


def _belongs(path: str, documents: Iterable[str]) -> bool:
    """Tell whether a file belongs to one of some shared documents: it has its path, perhaps with a suffix."""
    return any(path == each or path.startswith(f"{each}.") for each in documents)


@once
def installed_documents(session: Session, build_type: str) -> Mapping[str, bytes]:
    """Return the installed shared documents of a build type, by path; none if it has none.

    Raises:
        KeymintError: one cannot be read; or there is no record of the documents, and a package has defects.
    """
    if build_type not in users(session):
        return {}
    if built := session.state.stamp(BUILD, record_key(build_type)):
        return installed_shared(session, built.outputs)
    made = build_shared(session, build_type, api.BuildOptions(allow_vendor_specific=True))
    return installed_shared(session, made.documents)


@once
def documents_digest(session: Session, build_type: str) -> str:
    """Return the digest of the installed shared documents of a build type, or of why they cannot be read."""
    if build_type not in users(session):
        return ""
    try:
        return digest_files(installed_documents(session, build_type))
    except KeymintError as error:
        return digest(repr(error.diagnostics))


def enclaves_of(session: Session, build_type: str) -> Mapping[str, Mapping[str, bytes]]:
    """Return the files of a build type in the installed enclaves, by subject and name."""
    own = session.plugins.build_type(build_type).files(session.profile.layout)
    found: dict[str, Mapping[str, bytes]] = {}
    for name in users(session)[build_type]:
        files, _ = enclave_files(session, name)  # unreadable ones are findings on the enclave
        if files:
            found[subject_of(name)] = {file: content for file, content in files.items() if file in own}
    return found


def affected_packages(before: Session, after: Session) -> tuple[str, ...]:
    """Return the packages with an enclave whose shared documents a plan installs, sorted.

    Args:
        before: the workspace before the plan.
        after: the workspace after it.
    """
    names: set[str] = set()
    for build_type, of_type in users(after).items():
        key = record_key(build_type)
        if before.state.stamp(INSTALLED, key) != after.state.stamp(INSTALLED, key):
            names |= set(of_type)
    return tuple(sorted(names.intersection(enclave_names(after)))) if names else ()
