"""The stage ``install``: signs what was built and stages it for deployment."""

from __future__ import annotations

import stat
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from comarmor.errors import Diagnostic, Origin, Severity
from comarmor.text import did_you_mean
from keymint.api import Artifact, EnclaveCredentials, Package
from keymint.changes import Action, File, FolderChange, Plan, Step, changed
from keymint.errors import KeymintError
from keymint.pki import certificates, keys
from keymint.plan import build, identity_keys, key_record, lifetimes
from keymint.plan.authorities import MintedAuthority
from keymint.plan.enclaves import (
    CERTIFICATE,
    INSTALLED,
    enclave_files,
    installed,
    orphans,
    require_sources,
    unaccounted,
)
from keymint.plan.identity_keys import Keyring
from keymint.plan.lifetimes import Lifetime
from keymint.session import Inputs, Session
from keymint.state import Stamp, digest, digest_files
from keymint.workspace import placed

HAND_EDITED = "hand-edited"
"""Code of what is reported of a document that a person edited."""
OUTDATED = "build-outdated"
"""Code of the warning for builds whose sources changed."""
STAGE = INSTALLED


@dataclass(frozen=True, slots=True)
class _Enclave:
    """What planning one enclave gives."""

    step: Step
    stamp: Stamp | None
    build_type: str
    artifacts: Mapping[str, Artifact]
    diagnostics: Sequence[Diagnostic]
    fingerprint: str = ""
    """That of its key; empty when nothing of it was looked at, as nothing changed."""
    lifetimes: Sequence[Lifetime] = ()
    outdated: bool = False
    """Its sources changed since its documents were built."""


def plan_install(
    session: Session,
    names: Sequence[str],
    authorities: Mapping[str, MintedAuthority],
    *,
    prune: bool,
) -> Plan:
    """Plan the enclaves of some packages.

    Args:
        session: the workspace and its profile.
        names: names of packages that exist.
        authorities: what issues and signs.
        prune: remove installed enclaves that have no source package.

    Raises:
        KeymintError: the defects of all packages together, e.g. one that was not built.
    """
    owners = {keys.fingerprint(certificates.public_key(each.certificate)): who for who, each in authorities.items()}
    keyring = Keyring(session, owners)
    planned: list[_Enclave] = []
    errors: list[Diagnostic] = []
    for name in names:
        try:
            planned.append(_plan_enclave(session, name, authorities, keyring))
        except KeymintError as error:
            errors += error.diagnostics
    errors += _shared_keys(session, planned)
    if errors:
        raise KeymintError.of(errors)
    # What all share comes first: the folder around the enclaves is then made before there is anything in it.
    steps = [*_shared(session, planned), *(enclave.step for enclave in planned)]
    said = [diagnostic for enclave in planned for diagnostic in enclave.diagnostics]
    said += _outdated(session, [enclave.step.package for enclave in planned if enclave.outdated])
    said += lifetimes.findings({each.step.package: each.lifetimes for each in planned}, session)
    left = orphans(session)
    said += [found for found in unaccounted(session) if not prune or found.code != "enclave-orphaned"]
    if prune:
        require_sources(session)
        steps += [_prune(session, name) for name in left]
    stamps = {enclave.step.package: enclave.stamp for enclave in planned if enclave.stamp}
    state = session.state.updated(STAGE, stamps, removed=left if prune else ())
    fingerprints = {enclave.step.package: enclave.fingerprint for enclave in planned if enclave.fingerprint}
    state = key_record.record(state, key_record.IDENTITIES, fingerprints)
    if prune:
        state = key_record.forget(state, key_record.IDENTITIES, left)
    return Plan(tuple(steps), state, tuple(said))


def _shared_keys(inputs: Inputs, planned: Sequence[_Enclave]) -> Sequence[Diagnostic]:
    """Return an error for each key that two of the planned enclaves have."""
    owners: dict[str, str] = {}
    errors: list[Diagnostic] = []
    for enclave in planned:
        name = enclave.step.package
        other = owners.setdefault(enclave.fingerprint, name) if enclave.fingerprint else name
        if other != name:
            shown = Origin(inputs.workspace.shown(inputs.workspace.identity_key(name)))
            errors += identity_keys.shared(name, other, shown).diagnostics
    return errors


def built_documents(inputs: Inputs, name: str) -> dict[str, bytes]:
    """Return the unsigned documents of a package by file name, empty when it was not built."""
    folder = inputs.workspace.build / name
    stamp = inputs.state.stamp(build.STAGE, name)
    if stamp is None:
        return inputs.tree.files(folder)
    found = {file: inputs.tree.read(folder / file) for file in sorted(stamp.outputs)}
    return {file: content for file, content in found.items() if content is not None}


def _plan_enclave(
    session: Session,
    name: str,
    authorities: Mapping[str, MintedAuthority],
    keyring: Keyring,
) -> _Enclave:
    workspace = session.workspace
    documents = built_documents(session, name)
    key_path = workspace.identity_key(name)
    key_pem = session.tree.read(key_path)
    if not documents or key_pem is None:
        raise KeymintError(
            f"the package {name} is not built",
            help=f"run 'keymint build {name}'",
            code="not-built",
            where=Origin(workspace.shown(workspace.build / name)),
        )
    files = session.package_files(name)
    folder = workspace.enclaves(session.profile.layout) / name
    there_now = session.tree.status(folder)
    if there_now is not None and stat.S_ISLNK(there_now.st_mode):
        raise KeymintError(
            "is a symbolic link, which is refused: an enclave is a folder of its own",
            where=Origin(workspace.shown(folder)),
            help="remove the link",
            code="symlink-refused",
        )
    chains = {authority: minted.chain for authority, minted in authorities.items()}
    if is_current(session, name, files, chains):
        stamp = session.state.stamp(STAGE, name)
        own = lifetimes.recalled(session, name, stamp)
        return _Enclave(Step(STAGE, name, Action.UNCHANGED), None, "", {}, (), lifetimes=own)
    package = session.package(name)
    own = lifetimes.lifetimes(package)
    there, unread = enclave_files(session, folder, f"/{name}")
    public = identity_keys.load(session, package, key_path, key_pem).public_key()
    keyring.require_own(name, key_path, public)
    artifacts, said = _notarize(session, package, documents, authorities, key_pem, public, there)
    wrong_mode = [
        file for file, item in artifacts.items() if not _mode_is_right(session, folder / file, secret=item.secret)
    ]
    contents = {file: File(artifact.content, secret=artifact.secret) for file, artifact in artifacts.items()}
    different = {file: item for file, item in contents.items() if there.get(file) != item.content or file in wrong_mode}
    said = [*said, *_junk(session, folder, unread, artifacts)]
    if blocked := _blocking(session, folder, unread, artifacts):
        return _Enclave(Step(STAGE, name, Action.KEPT, (), "not updated"), None, "", {}, blocked, lifetimes=own)
    # The certificate comes last: until then a node that starts in between fails, and lets no one in.
    ordered = dict(sorted(different.items(), key=lambda item: item[0] == CERTIFICATE))
    changes = (FolderChange(folder, ordered),) if ordered else ()
    action = (Action.UPDATED if there else Action.CREATED) if changes else Action.UNCHANGED
    outputs = {file: digest(item.content) for file, item in contents.items()}
    secret = tuple(file for file, item in contents.items() if item.secret)
    wanted = _wanted(session, name, files, chains)
    recorded = session.state.stamp(build.STAGE, name) is not None  # of what no record knows nothing can be said
    edited = _edits(session, name, documents) if recorded else ()
    return _Enclave(
        Step(STAGE, name, action, changes),
        Stamp(wanted, outputs, secret, lifetimes=lifetimes.dump(own, session.workspace)),
        package.build_type,
        artifacts,
        [*said, *edited],
        keys.fingerprint(public),
        own,
        outdated=recorded and not build.is_current(session, name, files),
    )


def _blocking(
    inputs: Inputs, folder: Path, unread: Sequence[Diagnostic], artifacts: Mapping[str, Artifact]
) -> Sequence[Diagnostic]:
    """Return what stands where a file is to be written and is no file: it is not ours to replace."""
    places = {inputs.workspace.shown(folder / file) for file in artifacts}
    kinds = {"file-kind", "symlink-refused"}
    return [found for found in unread if found.code in kinds and found.where and found.where.file in places]


def _junk(
    inputs: Inputs, folder: Path, unread: Sequence[Diagnostic], artifacts: Mapping[str, Artifact]
) -> Sequence[Diagnostic]:
    """Return a warning for each file that cannot be read and does not belong to the enclave; others are replaced."""
    places = {inputs.workspace.shown(folder / file) for file in artifacts}
    others = (found for found in unread if not found.where or found.where.file not in places)
    return [replace(found, severity=Severity.WARNING) for found in others]


def _outdated(inputs: Inputs, names: Sequence[str]) -> Sequence[Diagnostic]:
    """Return the warning for documents whose sources changed after they were built; often one cause concerns many."""
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
            f"'keymint build {name}' rebuilds it" if one else "'keymint build' rebuilds all that is stale",
            f"/{name}" if one else "",
        ),
    )


def _edits(inputs: Inputs, name: str, documents: Mapping[str, bytes]) -> Sequence[Diagnostic]:
    """Return a warning for each document that is signed although it is not what the sources built."""
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


def _notarize(
    session: Session,
    package: Package,
    documents: Mapping[str, bytes],
    authorities: Mapping[str, MintedAuthority],
    pem: bytes,
    public: keys.PublicKey,
    there: Mapping[str, bytes],
) -> tuple[Mapping[str, Artifact], Sequence[Diagnostic]]:
    """Issue the certificate if the one that is there does not do, and have the documents signed."""
    issuer = authority_of(authorities, package.identity.issuer, package.identity.origin)
    notary = authority_of(authorities, package.permissions.issuer, package.permissions.origin)
    if package.governance.issuer != package.permissions.issuer:
        raise KeymintError(
            f"governance is signed by {package.governance.issuer!r}, permissions by {package.permissions.issuer!r}, "
            "but participants verify both with one permissions authority",
            where=package.permissions.origin,
            help="give both the same issuer_name",
            code="authority-mismatch",
        )
    certificate = there.get(CERTIFICATE)
    said: Sequence[Diagnostic] = ()
    if certificate is None or not certificates.certificate_satisfies(
        certificate, package.identity, public, issuer.issuer.certificate, authority=False
    ):
        issued = certificates.issue_identity(package.identity, public, issuer.issuer)
        certificate = issued.pem
        said = [replace(each, subject=package.subject) for each in issued.diagnostics]
    credentials = EnclaveCredentials(
        certificate=certificate,
        key=pem,
        identity_ca=issuer.chain,
        permissions_ca=notary.chain,
        signer=notary.signer,
    )
    build_type = session.plugins.build_type(package.build_type, session.package_marker(package.name))
    try:
        return build_type.install(package, documents, credentials, session.profile.layout, there), said
    except KeymintError as error:
        raise KeymintError.of(
            [placed(diagnostic, session.workspace.build) for diagnostic in error.diagnostics]
        ) from error


def authority_of(authorities: Mapping[str, MintedAuthority], name: str, origin: Origin) -> MintedAuthority:
    """Return an authority by name.

    Raises:
        KeymintError: the profile has none of this name.
    """
    if name not in authorities:
        raise KeymintError(
            f"no authority {name!r} in the profile, which has {', '.join(sorted(authorities)) or 'none'}",
            where=origin,
            help=did_you_mean(name, authorities, "name one in issuer_name"),
            code="authority-unknown",
        )
    return authorities[name]


def is_current(session: Session, name: str, files: dict[str, bytes], chains: Mapping[str, bytes]) -> bool:
    """Tell whether an enclave is what installing its package again would give, byte for byte and mode for mode.

    Args:
        session: the workspace and its profile.
        name: the package.
        files: the package's files.
        chains: certificates of the authorities by name.
    """
    stamp = session.state.stamp(STAGE, name)
    folder = session.workspace.enclaves(session.profile.layout) / name
    return (
        stamp is not None
        and stamp.inputs == _wanted(session, name, files, chains)
        and _in_place(session, folder, stamp)
    )


def _wanted(session: Session, name: str, files: dict[str, bytes], chains: Mapping[str, bytes]) -> str:
    return digest(
        build.wanted_inputs(session, files),
        digest_files(built_documents(session, name)),
        session.tree.read(session.workspace.identity_key(name)) or b"",
        digest_files(chains),
        session.profile.layout,
    )


def _in_place(inputs: Inputs, folder: Path, stamp: Stamp) -> bool:
    for file, value in stamp.outputs.items():
        try:
            content = inputs.tree.read(folder / file)
        except KeymintError:
            return False
        if content is None or digest(content) != value:
            return False
        if not _mode_is_right(inputs, folder / file, secret=file in stamp.secret):
            return False
    return True


def _mode_is_right(inputs: Inputs, path: Path, *, secret: bool) -> bool:
    """Tell whether a file on the disk has its mode; one that is only planned will have it."""
    status = inputs.tree.status(path)
    return status is None or stat.S_IMODE(status.st_mode) & 0o777 == (0o600 if secret else 0o644)


def _shared(session: Session, planned: Sequence[_Enclave]) -> list[Step]:
    """Plan the files that the layout keeps once for all enclaves, if any enclave changed."""
    if not any(enclave.artifacts for enclave in planned):
        return []
    layout = session.profile.layout
    by_type: dict[str, dict[str, Mapping[str, Artifact]]] = {}
    new = {enclave.step.package: enclave for enclave in planned if enclave.artifacts}
    types = {enclave.build_type for enclave in new.values()}
    for name in sorted({*new, *installed(session)}):
        if name in new:
            by_type.setdefault(new[name].build_type, {})[f"/{name}"] = new[name].artifacts
        elif len(types) == 1:
            there, _ = enclave_files(session, session.workspace.enclaves(layout) / name, f"/{name}")
            artifacts = {file: Artifact(content, secret=file == "key.pem") for file, content in there.items()}
            by_type.setdefault(next(iter(types)), {})[f"/{name}"] = artifacts
    steps = []
    for build_type, enclaves in sorted(by_type.items()):
        shared = session.plugins.build_type(build_type).shared(enclaves, layout)
        folders: dict[Path, dict[str, File]] = {}
        for relative, artifact in shared.items():
            path = session.workspace.install / relative
            folders.setdefault(path.parent, {})[path.name] = File(artifact.content, secret=artifact.secret)
        changes = [change for folder, files in folders.items() for change in changed(session.tree, folder, files)]
        if changes:
            known = any(session.tree.read(folder / name) for folder, files in folders.items() for name in files)
            action = Action.UPDATED if known else Action.CREATED
            steps.append(Step(STAGE, "", action, tuple(changes), "shared by all enclaves"))
    return steps


def _prune(session: Session, name: str) -> Step:
    folder = session.workspace.enclaves(session.profile.layout) / name
    files = [entry for entry, is_folder in session.tree.names(folder) if not is_folder]
    # The certificate goes last: what a killed run leaves of an enclave is still seen as one.
    ordered = tuple(sorted(files, key=lambda entry: entry == CERTIFICATE))
    return Step(STAGE, name, Action.REMOVED, (FolderChange(folder, {}, ordered),))
