# SPDX-License-Identifier: Apache-2.0
"""Sign and install the documents over all packages of a build type.

They are written before any enclave: rights of a new subject admit nobody until its enclave is there, and the rights of
a removed subject end before anything else changes.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import cast

from comarmor.errors import Diagnostic
from keymint.api import AuthorityRole, BuildType, Package, SharedCredentials, SharedDocuments
from keymint.authority.authorities import MintedAuthority
from keymint.authority.authority_files import chains_digest, trusted_chains
from keymint.errors import KeymintError
from keymint.names import subject_of
from keymint.stages.built_documents import OUTDATED, edits
from keymint.stages.package_stage import PackagePlan
from keymint.stages.shared_documents import (
    built_shared,
    is_current,
    load_packages,
    obsolete,
    record_key,
    removals,
    shared_folder,
    sources_digest,
    users,
    written,
)
from keymint.stages.signers import Signers
from keymint.stages.signing import authority_of
from keymint.store.changes import Action, File, Step
from keymint.view.stamps import Stamp, digest, digest_files
from keymint.workspace.installed_enclaves import INSTALLED, differing, has_outputs
from keymint.workspace.session import Session
from keymint.workspace.workspace import placed


def plan_shared_install(
    session: Session,
    chosen: Collection[str],
    authorities: Mapping[str, MintedAuthority],
    orphans: Sequence[str],
) -> list[PackagePlan]:
    """Return the plans for the installed shared documents of all build types.

    Args:
        session: the workspace and its profile.
        chosen: the packages that this run installs.
        authorities: the authorities that sign, by name.
        orphans: the enclaves that this run removes.

    Raises:
        KeymintError: the documents were not built or cannot be signed, or are stale although enclaves are removed.
    """
    planned: list[PackagePlan] = []
    for name, names in users(session).items():
        documents = built_shared(session, name)
        if documents is None:
            if not set(chosen).isdisjoint(names):
                raise KeymintError(
                    f"the shared documents of {name} are not built",
                    where=session.workspace.origin(shared_folder(session)),
                    help="run 'keymint build'",
                    code="not-built",
                )
            continue
        stale = _stale(session, name, documents, orphans)
        if is_installed(session, name, documents):
            planned.append(PackagePlan(record_key(name), diagnostics=stale))
        else:
            plan = _plan_documents(session, name, documents, authorities)
            edited = edits(session, record_key(name), shared_folder(session), documents)
            planned.append(replace(plan, diagnostics=(*stale, *edited)))
    return [*planned, *obsolete(session, INSTALLED, session.workspace.install)]


def _stale(session: Session, name: str, documents: Iterable[str], orphans: Sequence[str]) -> tuple[Diagnostic, ...]:
    """Return a warning if the documents of a build type are stale.

    Raises:
        KeymintError: they are, although enclaves are removed.
    """
    if is_current(session, name):
        return ()
    where = next((session.workspace.origin(shared_folder(session) / path) for path in documents), None)
    if orphans:
        raise KeymintError(
            f"is stale, and may still have the rights of {subject_of(orphans[0])}, whose enclave is to be removed",
            where=where,
            help="run 'keymint build' first",
            code=OUTDATED,
        )
    message, help_ = "is stale; signing the existing build", "'keymint build' rebuilds it"
    return (Diagnostic.warning(OUTDATED, message, where, help_),)


def is_installed(session: Session, name: str, documents: Mapping[str, bytes]) -> bool:
    """Tell whether installing the shared documents of a build type again would change no byte and no mode.

    Args:
        session: the workspace and its profile.
        name: name of the build type.
        documents: the unsigned documents.
    """
    stamp = session.state.stamp(INSTALLED, record_key(name))
    return (
        stamp is not None
        and stamp.inputs == _inputs_digest(session, name, documents)
        and has_outputs(session, str(session.workspace.install), stamp)
    )


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
            if not is_folder and belongs(entry, [path.name]):
                content = session.tree.read(path.parent / entry)
                if content is not None:
                    found[str((path.parent / entry).relative_to(install))] = content
    return found


def belongs(path: str, documents: Iterable[str]) -> bool:
    """Tell whether a file belongs to one of some shared documents: it has its path, perhaps with a suffix."""
    return any(path == each or path.startswith(f"{each}.") for each in documents)


def shared_roles(loaded: Iterable[Package], build_type: BuildType) -> Mapping[str, tuple[AuthorityRole, ...]]:
    """Return the authorities that packages have in each role, each name once.

    Raises:
        KeymintError: two packages have different authorities in a role that signs.
    """
    roles: dict[str, dict[str, AuthorityRole]] = {}
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


def _plan_documents(
    session: Session,
    name: str,
    documents: Mapping[str, bytes],
    authorities: Mapping[str, MintedAuthority],
) -> PackagePlan:
    build_type = session.plugins.build_type(name)
    loaded, chains = load_packages(session, name), trusted_chains(session)
    roles = {
        role: [(each, authority_of(authorities, each.name, each.origin)) for each in of_role]
        for role, of_role in shared_roles(loaded, build_type).items()
    }
    credentials = SharedCredentials(
        {role: b"".join(dict.fromkeys(chains[wanted.name] for wanted, _ in each)) for role, each in roles.items()},
        Signers({role: minted for role, each in roles.items() for wanted, minted in each if wanted.signs}),
    )
    existing = installed_shared(session, documents)
    try:
        artifacts = cast("SharedDocuments", build_type).install_shared(
            loaded, documents, credentials, session.profile.layout, existing
        )
    except KeymintError as error:
        raise KeymintError.of([placed(each, shared_folder(session)) for each in error.diagnostics]) from error
    if foreign := [path for path in artifacts if not belongs(path, documents)]:
        raise ValueError(f"{name} installs {foreign[0]!r}, which belongs to none of its shared documents")
    stamp = session.state.stamp(INSTALLED, record_key(name))
    install = session.workspace.install
    files = {path: File(artifact.content, secret=artifact.secret) for path, artifact in artifacts.items()}
    left_over = set(stamp.outputs if stamp else ()) - set(artifacts)
    changes = (*removals(session, install, left_over), *written(install, differing(session, install, existing, files)))
    action = Action.UPDATED if existing else Action.CREATED
    made = Stamp(
        _inputs_digest(session, name, documents),
        {path: file.digest for path, file in files.items()},
        tuple(path for path, file in files.items() if file.secret),
        build_types=(name,),
    )
    step = Step(INSTALLED, "", action, changes, f"{', '.join(documents)}, for all enclaves")
    return PackagePlan(record_key(name), step if changes else None, made)


def _inputs_digest(session: Session, name: str, documents: Mapping[str, bytes]) -> str:
    return digest(sources_digest(session, name), digest_files(documents), chains_digest(session))
