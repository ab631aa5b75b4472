# SPDX-License-Identifier: Apache-2.0
"""The stage ``install``: sign the built documents and lay out the enclaves for deployment."""

from __future__ import annotations

import stat
from collections.abc import Mapping, Sequence
from dataclasses import replace

from comarmor.errors import Diagnostic, Origin, Severity
from keymint.changes import Action, File, FolderChange, Plan, Step, file_mode
from keymint.errors import KeymintError
from keymint.pki import certificates, keys
from keymint.plan import build, identity_keys, key_record, lifetimes
from keymint.plan.authorities import MintedAuthority
from keymint.plan.build_types import build_types_of, inputs_digest
from keymint.plan.enclaves import CERTIFICATE, INSTALLED, enclave_files, orphans, require_sources, unaccounted
from keymint.plan.identity_keys import Keyring
from keymint.plan.shared_files import shared_steps
from keymint.plan.shared_install import HAND_EDITED, OUTDATED, plan_shared_install
from keymint.plan.signing import sign
from keymint.plan.stage import PackagePlan, recorded, steps_of
from keymint.session import Inputs, Session
from keymint.state import Stamp, digest, digest_files

STAGE = INSTALLED


class InstallStage:
    """The stage ``install``.

    Args:
        session: the workspace and its profile.
        authorities: the authorities that issue and sign, by name.
        prune: remove installed enclaves that have no source package.
    """

    NAME = STAGE

    def __init__(self, session: Session, authorities: Mapping[str, MintedAuthority], *, prune: bool) -> None:
        self._session = session
        self._authorities = authorities
        self._prune = prune
        owners = {keys.fingerprint(certificates.public_key(each.certificate)): who for who, each in authorities.items()}
        self._keyring = Keyring(session, owners)

    def package(self, name: str) -> PackagePlan:
        """Return the plan for the enclave of a package."""
        try:
            return _plan_enclave(self._session, name, self._authorities, self._keyring)
        except KeymintError as error:
            return PackagePlan(name, errors=tuple(error.diagnostics))

    def plan(self, planned: Sequence[PackagePlan]) -> Plan:
        """Put the plans for some enclaves together, and add what they share and what is pruned."""
        session, prune = self._session, self._prune
        fingerprints = {each.name: each.fingerprint for each in planned if each.fingerprint}
        errors = [error for each in planned for error in each.errors]
        errors += identity_keys.shared_keys(session, fingerprints)
        if errors:
            raise KeymintError.of(errors)
        # Shared documents come first: rights end before an enclave is removed, and begin before one is there. So do
        # copies, so that the folder around the enclaves exists before any enclave.
        changed = {each.name: (each.build_types, each.artifacts) for each in planned if each.build_types}
        removed = orphans(session) if prune else ()
        shared = plan_shared_install(session, [each.name for each in planned], self._authorities, removed)
        steps = [*shared.steps, *shared_steps(session, changed), *steps_of(planned)]
        diagnostics = [diagnostic for each in planned for diagnostic in each.diagnostics]
        diagnostics += _outdated(session, [each.name for each in planned if each.outdated])
        diagnostics += shared.diagnostics
        diagnostics += lifetimes.findings({each.name: each.lifetimes for each in planned}, session)
        diagnostics += [each for each in unaccounted(session) if not prune or each.code != "enclave-orphaned"]
        state = recorded(session.state, STAGE, planned, (*removed, *shared.removed))
        state = state.updated(STAGE, shared.stamps)
        if prune:
            require_sources(session)
            steps += [_prune(session, name) for name in removed]
            state = key_record.forget(state, key_record.IDENTITIES, removed)
        return Plan(tuple(steps), state, tuple(diagnostics))


def _plan_enclave(
    session: Session, name: str, authorities: Mapping[str, MintedAuthority], keyring: Keyring
) -> PackagePlan:
    workspace = session.workspace
    inputs = _inputs_digest(session, name, {authority: minted.chain for authority, minted in authorities.items()})
    if inputs is None:
        raise KeymintError(
            f"the package {name} is not built",
            help=f"run 'keymint build {name}'",
            code="not-built",
            where=Origin(workspace.shown(workspace.build / name)),
        )
    status = session.tree.status(f"{session.enclaves}/{name}")
    if status is not None and stat.S_ISLNK(status.st_mode):
        raise KeymintError(
            "is a symbolic link, which is refused: an enclave must be a folder",
            where=Origin(workspace.shown(session.enclaves / name)),
            help="remove the link",
            code="symlink-refused",
        )
    stamp = session.state.stamp(STAGE, name)
    if stamp is not None and _has_outputs(session, name, stamp, inputs):
        own = lifetimes.recalled(session, name, stamp)
        return PackagePlan(name, Step(STAGE, name, Action.UNCHANGED), lifetimes=own)
    package, folder = session.package(name), session.enclaves / name
    own = lifetimes.lifetimes(package)
    documents = build.built_documents(session, name)
    existing, unreadable = enclave_files(session, name)
    key_pem, public = identity_keys.private_key(session, package), identity_keys.public_key(session, package)
    fingerprint = identity_keys.require_own(session, package, keyring, public)
    artifacts, warnings = sign(session, package, documents, authorities, (key_pem, public), existing)
    paths = {workspace.shown(folder / file) for file in artifacts} if unreadable else set()
    if blocking := [each for each in unreadable if _is_blocking(each, paths)]:
        kept = Step(STAGE, name, Action.KEPT, detail="not updated")
        return PackagePlan(name, kept, diagnostics=tuple(blocking), lifetimes=own)
    files = {file: File(artifact.content, secret=artifact.secret) for file, artifact in artifacts.items()}
    different = {
        file: item
        for file, item in files.items()
        if existing.get(file) != item.content or not _has_mode(session, f"{folder}/{file}", secret=item.secret)
    }
    # The certificate comes last: a node that starts in between fails, and admits nobody.
    ordered = dict(sorted(different.items(), key=lambda item: item[0] == CERTIFICATE))
    # What another build type of the package installed before would still have effect.
    obsolete = tuple(file for file in sorted(stamp.outputs) if file not in files and file in existing) if stamp else ()
    changes = (FolderChange(folder, ordered, obsolete),) if ordered or obsolete else ()
    action = (Action.UPDATED if existing else Action.CREATED) if changes else Action.UNCHANGED
    # Unreadable files that do not belong to the enclave are only reported; the others are replaced.
    foreign = [each for each in unreadable if not each.where or each.where.file not in paths]
    # Without a record of the build nothing is known about edits or staleness.
    is_recorded = session.state.stamp(build.STAGE, name) is not None
    build_types = build_types_of(session, package)
    copied = {file for each in build_types.values() for file in each.COPIED}
    edits = _edits(session, name, documents) if is_recorded else ()
    made = Stamp(
        inputs,
        {file: item.digest for file, item in files.items()},
        tuple(file for file, item in files.items() if item.secret),
        lifetimes=lifetimes.dump(own, workspace),
    )
    return PackagePlan(
        name,
        Step(STAGE, name, action, changes),
        made,
        (*warnings, *(replace(each, severity=Severity.WARNING) for each in foreign), *edits),
        fingerprint=fingerprint,
        lifetimes=own,
        build_types=tuple(build_types),
        artifacts={file: artifacts[file] for file in copied if file in artifacts},
        outdated=is_recorded and not build.is_current(session, name),
    )


def _is_blocking(unreadable: Diagnostic, paths: set[str]) -> bool:
    """Tell whether something that is not a regular file is in the place of an enclave's file."""
    where = unreadable.where
    return unreadable.code in {"file-kind", "symlink-refused"} and where is not None and where.file in paths


def _outdated(inputs: Inputs, names: Sequence[str]) -> Sequence[Diagnostic]:
    """Return one warning for all packages whose build is stale; they often have one cause."""
    if not names:
        return ()
    name = names[0]
    one = len(names) == 1
    return (
        Diagnostic(
            OUTDATED,
            Severity.WARNING,
            "is stale; signing the existing build" + ("" if one else f" [{len(names)} packages]"),
            Origin(inputs.workspace.shown(inputs.workspace.build / name)),
            f"'keymint build {name}' rebuilds it" if one else "'keymint build' rebuilds all stale packages",
            f"/{name}" if one else "",
        ),
    )


def _edits(inputs: Inputs, name: str, documents: Mapping[str, bytes]) -> Sequence[Diagnostic]:
    """Return a warning for each document that is signed although it differs from the built one."""
    return [
        Diagnostic(
            HAND_EDITED,
            Severity.WARNING,
            "was edited by hand; signing the edited document",
            Origin(inputs.workspace.shown(inputs.workspace.build / name / file)),
            f"'keymint build -f {name}' discards the edit",
            f"/{name}",
        )
        for file, content in documents.items()
        if not inputs.state.wrote(build.STAGE, name, file, content)
    ]


def is_current(session: Session, name: str, chains: Mapping[str, bytes]) -> bool:
    """Tell whether installing a package again would change no byte and no mode of its enclave.

    Args:
        session: the workspace and its profile.
        name: the package.
        chains: certificates of the authorities by name.
    """
    stamp = session.state.stamp(STAGE, name)
    return stamp is not None and _has_outputs(session, name, stamp, _inputs_digest(session, name, chains))


def _has_outputs(session: Session, name: str, stamp: Stamp, inputs: str | None) -> bool:
    """Tell whether an enclave was made from these inputs, and is as it was made."""
    folder = f"{session.enclaves}/{name}"
    try:
        return stamp.inputs == inputs and all(
            session.tree.digest(f"{folder}/{file}") == value
            and _has_mode(session, f"{folder}/{file}", secret=file in stamp.secret)
            for file, value in stamp.outputs.items()
        )
    except KeymintError:
        return False  # a file cannot be read


def _inputs_digest(session: Session, name: str, chains: Mapping[str, bytes]) -> str | None:
    """Return the digest of all that an enclave is made from, or None if its package is not built."""
    documents = build.document_digests(session, name)
    key = identity_keys.key_digest(session, name)
    if documents is None or key is None:
        return None
    built = (part for item in sorted(documents.items()) for part in item)
    return digest(inputs_digest(session, name), key, digest_files(chains), session.profile.layout, *built)


def _has_mode(inputs: Inputs, path: str, *, secret: bool) -> bool:
    """Tell whether a file on the disk has the mode that it should have; planned files will have it."""
    status = inputs.tree.status(path)
    return status is None or stat.S_IMODE(status.st_mode) & 0o777 == file_mode(secret=secret)


def _prune(session: Session, name: str) -> Step:
    folder = session.enclaves / name
    files = [entry for entry, is_folder in session.tree.names(folder) if not is_folder]
    # The certificate goes last, so that what a killed run leaves is still recognised as an enclave.
    ordered = tuple(sorted(files, key=lambda entry: entry == CERTIFICATE))
    return Step(STAGE, name, Action.REMOVED, (FolderChange(folder, removed=ordered),))
