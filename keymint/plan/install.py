# SPDX-License-Identifier: Apache-2.0
"""The stage ``install``: sign the built documents and lay out the enclaves for deployment."""

from __future__ import annotations

import stat
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from comarmor.errors import Diagnostic, Origin, Severity
from keymint.api import Artifact
from keymint.changes import Action, File, FolderChange, Plan, Step, file_mode
from keymint.errors import KeymintError
from keymint.pki import certificates, keys
from keymint.plan import build, identity_keys, key_record, lifetimes
from keymint.plan.authorities import MintedAuthority
from keymint.plan.build_types import build_types_of, inputs_digest
from keymint.plan.enclaves import CERTIFICATE, INSTALLED, enclave_files, orphans, require_sources, unaccounted
from keymint.plan.identity_keys import Keyring
from keymint.plan.lifetimes import Lifetime
from keymint.plan.shared_files import shared_steps
from keymint.plan.shared_install import HAND_EDITED, OUTDATED, plan_shared_install
from keymint.plan.signing import sign
from keymint.session import Inputs, Session
from keymint.state import Stamp, digest, digest_files

STAGE = INSTALLED


@dataclass(frozen=True, slots=True)
class _EnclavePlan:
    """The plan for one enclave.

    Attributes:
        step: what is written.
        stamp: the record of it; None if nothing changes.
        build_types: the package's build types.
        artifacts: the files of the enclave; empty if nothing changes.
        diagnostics: warnings about the package.
        fingerprint: fingerprint of the subject's key; empty if nothing changes.
        lifetimes: validity of the package's grant and certificate.
        outdated: the package's sources changed after its documents were built.
    """

    step: Step
    stamp: Stamp | None = None
    build_types: tuple[str, ...] = ()
    artifacts: Mapping[str, Artifact] = field(default_factory=dict)
    diagnostics: Sequence[Diagnostic] = ()
    fingerprint: str = ""
    lifetimes: Sequence[Lifetime] = ()
    outdated: bool = False


def plan_install(
    session: Session, names: Sequence[str], authorities: Mapping[str, MintedAuthority], *, prune: bool
) -> Plan:
    """Plan the enclaves of some packages.

    Args:
        session: the workspace and its profile.
        names: names of existing packages.
        authorities: the authorities that issue and sign, by name.
        prune: remove installed enclaves that have no source package.

    Raises:
        KeymintError: the defects of all packages together, e.g. one that was not built.
    """
    owners = {keys.fingerprint(certificates.public_key(each.certificate)): who for who, each in authorities.items()}
    keyring = Keyring(session, owners)
    planned: list[_EnclavePlan] = []
    errors: list[Diagnostic] = []
    for name in names:
        try:
            planned.append(_plan_enclave(session, name, authorities, keyring))
        except KeymintError as error:
            errors += error.diagnostics
    fingerprints = {enclave.step.package: enclave.fingerprint for enclave in planned if enclave.fingerprint}
    errors += identity_keys.shared_keys(session, fingerprints)
    if errors:
        raise KeymintError.of(errors)
    # Shared documents come first: rights end before an enclave is removed, and begin before one is there. So do copies,
    # so that the folder around the enclaves exists before any enclave.
    changed = {each.step.package: (each.build_types, each.artifacts) for each in planned if each.artifacts}
    removed = orphans(session) if prune else ()
    shared = plan_shared_install(session, names, authorities, removed)
    steps = [*shared.steps, *shared_steps(session, changed), *(enclave.step for enclave in planned)]
    diagnostics = [diagnostic for enclave in planned for diagnostic in enclave.diagnostics]
    diagnostics += _outdated(session, [enclave.step.package for enclave in planned if enclave.outdated])
    diagnostics += shared.diagnostics
    diagnostics += lifetimes.findings({each.step.package: each.lifetimes for each in planned}, session)
    diagnostics += [each for each in unaccounted(session) if not prune or each.code != "enclave-orphaned"]
    stamps = {**shared.stamps, **{each.step.package: each.stamp for each in planned if each.stamp}}
    state = session.state.updated(STAGE, stamps, (*removed, *shared.removed))
    state = key_record.record(state, key_record.IDENTITIES, fingerprints)
    if prune:
        require_sources(session)
        steps += [_prune(session, name) for name in removed]
        state = key_record.forget(state, key_record.IDENTITIES, removed)
    return Plan(tuple(steps), state, tuple(diagnostics))


def _plan_enclave(
    session: Session, name: str, authorities: Mapping[str, MintedAuthority], keyring: Keyring
) -> _EnclavePlan:
    workspace = session.workspace
    documents = build.built_documents(session, name)
    key_path = workspace.identity_key(name)
    key_pem = session.tree.read(key_path)
    if not build.is_built(session, name) or key_pem is None:
        raise KeymintError(
            f"the package {name} is not built",
            help=f"run 'keymint build {name}'",
            code="not-built",
            where=Origin(workspace.shown(workspace.build / name)),
        )
    folder = session.enclaves / name
    status = session.tree.status(folder)
    if status is not None and stat.S_ISLNK(status.st_mode):
        raise KeymintError(
            "is a symbolic link, which is refused: an enclave must be a folder",
            where=Origin(workspace.shown(folder)),
            help="remove the link",
            code="symlink-refused",
        )
    chains = {authority: minted.chain for authority, minted in authorities.items()}
    recorded = session.state.stamp(STAGE, name)
    if is_current(session, name, chains):
        return _EnclavePlan(Step(STAGE, name, Action.UNCHANGED), lifetimes=lifetimes.recalled(session, name, recorded))
    package = session.package(name)
    own = lifetimes.lifetimes(package)
    existing, unreadable = enclave_files(session, name)
    public = identity_keys.load(session, package, key_path, key_pem).public_key()
    keyring.require_own(name, key_path, public)
    artifacts, warnings = sign(session, package, documents, authorities, (key_pem, public), existing)
    paths = {workspace.shown(folder / file) for file in artifacts}
    if blocking := [each for each in unreadable if _is_blocking(each, paths)]:
        return _EnclavePlan(Step(STAGE, name, Action.KEPT, detail="not updated"), diagnostics=blocking, lifetimes=own)
    files = {file: File(artifact.content, secret=artifact.secret) for file, artifact in artifacts.items()}
    different = {
        file: item
        for file, item in files.items()
        if existing.get(file) != item.content or not _has_mode(session, folder / file, secret=item.secret)
    }
    # The certificate comes last: a node that starts in between fails, and admits nobody.
    ordered = dict(sorted(different.items(), key=lambda item: item[0] == CERTIFICATE))
    # What another build type of the package installed before would still have effect.
    obsolete = (
        tuple(file for file in sorted(recorded.outputs) if file not in files and file in existing) if recorded else ()
    )
    changes = (FolderChange(folder, ordered, obsolete),) if ordered or obsolete else ()
    action = (Action.UPDATED if existing else Action.CREATED) if changes else Action.UNCHANGED
    # Unreadable files that do not belong to the enclave are only reported; the others are replaced.
    foreign = [each for each in unreadable if not each.where or each.where.file not in paths]
    # Without a record of the build nothing is known about edits or staleness.
    is_recorded = session.state.stamp(build.STAGE, name) is not None
    return _EnclavePlan(
        Step(STAGE, name, action, changes),
        Stamp(
            _inputs_digest(session, name, chains),
            {file: digest(item.content) for file, item in files.items()},
            tuple(file for file, item in files.items() if item.secret),
            lifetimes=lifetimes.dump(own, workspace),
        ),
        tuple(build_types_of(session, package)),
        artifacts,
        [
            *warnings,
            *(replace(each, severity=Severity.WARNING) for each in foreign),
            *(_edits(session, name, documents) if is_recorded else ()),
        ],
        keys.fingerprint(public),
        own,
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
    folder = session.enclaves / name
    return (
        stamp is not None
        and stamp.inputs == _inputs_digest(session, name, chains)
        and all(
            (content := session.tree.try_read(folder / file)) is not None
            and digest(content) == value
            and _has_mode(session, folder / file, secret=file in stamp.secret)
            for file, value in stamp.outputs.items()
        )
    )


def _inputs_digest(session: Session, name: str, chains: Mapping[str, bytes]) -> str:
    return digest(
        inputs_digest(session, name),
        digest_files(build.built_documents(session, name)),
        session.tree.read(session.workspace.identity_key(name)) or b"",
        digest_files(chains),
        session.profile.layout,
    )


def _has_mode(inputs: Inputs, path: Path, *, secret: bool) -> bool:
    """Tell whether a file on the disk has the mode that it should have; planned files will have it."""
    status = inputs.tree.status(path)
    return status is None or stat.S_IMODE(status.st_mode) & 0o777 == file_mode(secret=secret)


def _prune(session: Session, name: str) -> Step:
    folder = session.enclaves / name
    files = [entry for entry, is_folder in session.tree.names(folder) if not is_folder]
    # The certificate goes last, so that what a killed run leaves is still recognised as an enclave.
    ordered = tuple(sorted(files, key=lambda entry: entry == CERTIFICATE))
    return Step(STAGE, name, Action.REMOVED, (FolderChange(folder, removed=ordered),))
