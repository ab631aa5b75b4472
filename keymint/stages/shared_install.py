# SPDX-License-Identifier: Apache-2.0
"""Sign and install the documents over all packages of a build type, and read what is installed for their proof.

They are written before any enclave: rights of a new subject admit nobody until its enclave is there, and the rights of
a removed subject end before anything else changes.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace

from comarmor.errors import Diagnostic
from keymint import __version__
from keymint.api import AuthorityRole, BuildOptions, BuildType, Package, SharedCredentials
from keymint.authority.authorities import MintedAuthority
from keymint.authority.authority_files import chains_digest, trusted_chains
from keymint.errors import KeymintError
from keymint.names import subject_of
from keymint.stages.built_documents import OUTDATED, edits
from keymint.stages.package_stage import PackagePlan
from keymint.stages.shared_documents import (
    build_shared,
    built_shared,
    file_changes,
    is_current,
    load_packages,
    obsolete,
    record_key,
    removals,
    shared_folder,
    sources_digest,
    users,
)
from keymint.stages.signing import Signers, authority_of
from keymint.store.changes import Action, File, Step
from keymint.view.stamps import Stamp, digest, digest_files
from keymint.workspace.installed_enclaves import INSTALLED, enclave_files, enclave_names, has_outputs, new_files
from keymint.workspace.package_build_types import BUILD
from keymint.workspace.session import Session, once
from keymint.workspace.workspace import with_place


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
        artifacts = build_type.install_shared(loaded, documents, credentials, session.profile.layout, existing)
    except KeymintError as error:
        raise KeymintError.of([with_place(each, shared_folder(session)) for each in error.diagnostics]) from error
    if foreign := [path for path in artifacts if not belongs(path, documents)]:
        raise ValueError(f"{name} installs {foreign[0]!r}, which belongs to none of its shared documents")
    stamp = session.state.stamp(INSTALLED, record_key(name))
    install = session.workspace.install
    files = {path: File(artifact.content, secret=artifact.secret) for path, artifact in artifacts.items()}
    stale = set(stamp.outputs if stamp else ()) - set(artifacts)
    changes = (*removals(session, install, stale), *file_changes(install, new_files(session, install, existing, files)))
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


# -- what is proven of them ------------------------------------------------------------------------------------------


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
    accepting = BuildOptions(allow_vendor_specific=True)
    made = build_shared(session, build_type, load_packages(session, build_type), accepting)
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


def claims_digest(session: Session, build_type: str, enclaves: Mapping[str, Mapping[str, bytes]]) -> str:
    """Return the digest of everything that claims across subjects depend on, except the policy.

    Args:
        session: the workspace and its profile.
        build_type: name of the build type.
        enclaves: files of its enclaves.
    """
    of_enclaves = (part for subject, files in enclaves.items() for part in (subject, digest_files(files)))
    sources = sources_digest(session, build_type)
    return digest(sources, documents_digest(session, build_type), chains_digest(session), __version__, *of_enclaves)


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
