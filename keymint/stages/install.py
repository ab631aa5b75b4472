# SPDX-License-Identifier: Apache-2.0
"""The stage ``install``: sign the built documents and lay out the enclaves for deployment."""

from __future__ import annotations

import stat
from collections.abc import Collection, Iterator, Mapping, Sequence
from itertools import chain
from typing import Any

from cryptography import x509

from comarmor.values import replace
from keymint.api import Package, lazy
from keymint.authority.authorities import Authorities
from keymint.authority.authority_files import chains_digest
from keymint.errors import Diagnostic, KeymintError, Severity, require_none
from keymint.life import revocation_lists_in_force, terms, workspace_register
from keymint.life.examine import Keyring, orphan_findings, replaced_rights, shared_keys
from keymint.life.register import SignedRights
from keymint.life.workspace_register import register_of
from keymint.names import subject_of
from keymint.pki import certificates, revocation_lists
from keymint.pki.distinguished_names import to_text
from keymint.stages import identities
from keymint.stages.documents import (
    OUTDATED,
    built_documents,
    document_digests,
    documents_folder,
    edits,
    is_built,
    obsolete_documents,
    removals,
    sign_shared,
)
from keymint.stages.environment_scripts import plan_scripts
from keymint.stages.work import NewPackage, PackagePlan, PackageStage, state_after, steps_of
from keymint.store.changes import Action, File, FolderChange, Plan, Step, by_folder
from keymint.view.stamps import Stamp, digest, digest_files, digest_of_texts, stamp_of
from keymint.workspace import installed_enclaves
from keymint.workspace.installed_enclaves import (
    CERTIFICATE,
    INSTALLED,
    enclave_files,
    enclave_names,
    has_outputs,
    new_files,
    orphans,
    require_sources,
)
from keymint.workspace.package_build_types import (
    BUILD,
    build_types_of,
    inputs_digest,
    is_build_current,
    load_packages,
    record_key,
    shared_type,
    users,
)
from keymint.workspace.session import Inputs, Session
from keymint.workspace.stored_keys import IDENTITY_KEYS, known_fingerprint, without_recorded_keys

STAGE = INSTALLED
_common_form = lazy("keymint.stages.enclave_forms:common_form")  # a small workspace has one of each kind
_changed_rights = lazy("keymint.stages.changed_rights:changed_rights")  # a new fleet has nothing to compare
_STALE = "is stale; signing the existing build"


class InstallStage(PackageStage):
    """The stage ``install``.

    Args:
        session: the workspace and its profile, with these authorities.
        authorities: the authorities that issue and sign, by name.
        prune: remove installed enclaves that have no source package.
        settled: packages that nothing changed for.

    Attributes:
        rights: what subjects gain and lose by the plan that was made last.
    """

    NAME = STAGE
    rights: tuple[Any, ...] = ()

    def __init__(
        self, session: Session, authorities: Authorities, *, prune: bool, settled: frozenset[str] = frozenset()
    ) -> None:
        self._session = session
        self._authorities = authorities
        self._prune = prune
        self._settled = settled
        self._keyring = Keyring(session)

    def package(self, name: str) -> PackagePlan:
        """Return the plan for the enclave of a package."""
        try:
            return _plan_enclave(self._session, name, self._authorities, self._keyring)
        except KeymintError as error:
            return PackagePlan(name, errors=tuple(error.diagnostics))

    def new(self, new: NewPackage) -> PackagePlan:
        """See :meth:`keymint.stages.work.PackageStage.new`."""
        if found := new.forms.of(STAGE, new.kind):
            new.form, like = found
            return self._filled(new, like)
        plan = self.package(new.name)
        if plan.issued and plan.step and not plan.diagnostics:
            (change,) = plan.step.changes
            new.files = change.files
            new.forms.learn(STAGE, new, (new, plan), self._form)
        return plan

    def _form(
        self, one: tuple[NewPackage, PackagePlan], other: tuple[NewPackage, PackagePlan]
    ) -> tuple[Any, PackagePlan] | None:
        """Return the form of two new enclaves, and the plan for one; None if the plans differ otherwise."""
        (_, plan), (_, like) = one, other
        first, second = ((each.build_types, each.artifacts, each.lifetimes) for each in (plan, like))
        form = _common_form(one, other, self._authorities) if first == second else None
        return (form, plan) if form else None

    def _filled(self, new: NewPackage, like: PackagePlan) -> PackagePlan:
        """Return the plan for an enclave that is filled in from a form, as that for another one."""
        session, name, (key,) = self._session, new.name, new.key.files.values()
        new.files, issued, signed = new.form.fill(new, self._authorities, session.now)
        digests = {file: each.digest for file, each in new.documents.items()}
        inputs = _inputs(session, new.inputs, key.digest, digests)
        change = FolderChange(session.enclave_folder(name), new.files, private=True)
        return PackagePlan(
            name,
            Step(STAGE, name, Action.CREATED, (change,)),
            _stamp(inputs, new.files, lifetimes=stamp_of(new.built.stamp).lifetimes if new.built.stamp else ""),
            fingerprint=new.built.fingerprint,
            lifetimes=new.built.lifetimes,
            build_types=like.build_types,
            artifacts=like.artifacts,
            issued=issued,
            signed=signed,
        )

    def plan(self, planned: Sequence[PackagePlan]) -> Plan:
        """Put the plans for some enclaves together, and add what they share and what is pruned."""
        session, prune = self._session, self._prune
        fingerprints = {each.name: each.fingerprint for each in planned if each.fingerprint}
        errors = [error for each in planned for error in each.errors]
        errors += shared_keys(session, fingerprints)
        require_none(errors)
        # Shared documents come first: rights end before an enclave is removed, and begin before one is there. So do
        # copies, so that the folder around the enclaves exists before any enclave.
        changed = {each.name: (each.build_types, each.artifacts) for each in planned if each.build_types}
        removed = orphans(session) if prune else ()
        shared = _plan_shared(session, [each.name for each in planned], self._authorities, removed)
        self.rights = tuple(found for each in (*planned, *shared) for found in each.rights)
        withdrawn = {each.name: each.withdrawn for each in planned if each.withdrawn}
        changes = installed_enclaves.EnclaveChanges(changed, frozenset((*removed, *withdrawn)))
        scripts, foreign = plan_scripts(session, installed_enclaves.build_types_in_use(session, changes))
        copies = [] if self._keeps_copies(changes) else installed_enclaves.shared_copies(session, changes)
        steps = [
            *steps_of(shared),
            *installed_enclaves.shared_steps(session, copies, changes),
            *scripts,
            *steps_of(planned),
        ]
        diagnostics = [*(diagnostic for each in planned for diagnostic in each.diagnostics), *foreign]
        diagnostics += _outdated(session, [each.name for each in planned if each.outdated])
        diagnostics += (diagnostic for each in shared for diagnostic in each.diagnostics)
        diagnostics += terms.of_sources({each.name: each.lifetimes for each in planned}, session)
        diagnostics += orphan_findings(session, pruned=prune)
        state = state_after(session.state, STAGE, [*shared, *planned], (*removed, *withdrawn))
        steps += [installed_enclaves.withdraw(session, name, reason, changes) for name, reason in withdrawn.items()]
        if prune:
            require_sources(session)
            diagnostics += _still_good(session, removed)
            steps += [installed_enclaves.removal_step(session, name, changes) for name in removed]
            steps += installed_enclaves.last_steps(session, changes)
            state = without_recorded_keys(state, IDENTITY_KEYS, removed)
        steps += installed_enclaves.obsolete_steps(session, copies, steps)
        return Plan(tuple(steps), state, tuple(diagnostics), _register(session, planned))

    def _keeps_copies(self, changes: installed_enclaves.EnclaveChanges) -> bool:
        """Tell whether the files that all enclaves share are those that were there, and no enclave gets others."""
        session = self._session
        shared = f"{session.workspace.install}/", f"{session.enclaves}/"
        beside = (f"{folder}/" for folder in session.tree.changed or () if f"{folder}/".startswith(shared[0]))
        return (
            bool(self._settled)
            and not changes.removed
            and all(folder.startswith(shared[1]) and folder != shared[1] for folder in beside)
            and all(
                session.tree.digest(f"{session.enclave_folder(name)}/{file}") == digest(artifact.content)
                for name, (_, artifacts) in changes.changed.items()
                for file, artifact in artifacts.items()
            )
        )


def _still_good(session: Session, removed: Sequence[str]) -> Iterator[Diagnostic]:
    """Yield a warning if certificates of enclaves that are removed stay good."""
    ends = {name: each.not_after for name in removed for each in register_of(session).in_force(name, session.now)}
    if ends:
        name, end = max(ends.items(), key=lambda item: item[1])
        others = f" [{len(ends)} enclaves]" if len(ends) > 1 else ""
        yield Diagnostic.warning(
            "certificate-in-force",
            f"the certificate of the removed enclave {subject_of(name)} remains valid until {terms.iso_time(end)}"
            f"{others}",
            None,
            f"'keymint revoke {name} --reason retired' ends it",
            subject_of(name) if len(ends) == 1 else "",
        )


def _register(session: Session, planned: Sequence[PackagePlan]) -> tuple[FolderChange, ...]:
    """Return what adds the certificates of some plans to the register.

    Raises:
        KeymintError: the register cannot be restored, or two certificates have one serial number.
    """
    issued = [each.issued for each in planned if each.issued]
    if not issued:
        return ()
    register = workspace_register.complete_register(session)
    workspace_register.require_free_serials(register, issued)
    known = {each.key for each in register.certificates.values()}
    if any(each.issued and each.key in known for each in issued):
        revocation_lists_in_force.require_lists_known(session, register)
    signed = (each for plan in planned for each in plan.signed)
    return workspace_register.register_change(session, register.with_issued(issued).with_rights(signed))


def _plan_enclave(session: Session, name: str, authorities: Authorities, keyring: Keyring) -> PackagePlan:
    workspace = session.workspace
    inputs = inputs_of(session, name)
    if inputs is None and is_built(session, name) and identities.is_awaited(session.package(name)):
        return _awaiting(session, session.package(name))
    if inputs is None:
        raise _not_built(session, name, f"the package {name} is")
    status = session.tree.status(session.enclave_folder(name))
    if status is not None and stat.S_ISLNK(status.st_mode):
        raise KeymintError(
            "is a symbolic link, which is refused: an enclave must be a folder",
            where=workspace.origin(session.enclave_folder(name)),
            help="remove the link",
            code="symlink-refused",
        )
    stamp = session.state.stamp(STAGE, name)
    if stamp and stamp.inputs == inputs and has_outputs(session, session.enclave_folder(name), stamp):
        own = terms.recorded_terms(session, name, stamp)
        return PackagePlan(name, Step(STAGE, name, Action.UNCHANGED), lifetimes=own)
    package, folder = session.package(name), session.enclave(name)
    own = terms.lifetimes(package)
    if identities.is_awaited(package):
        return _awaiting(session, package)
    documents = built_documents(session, name)
    existing, unreadable = enclave_files(session, name)
    key_pem, public = identities.private_key(session, package), identities.public_key(session, package)
    fingerprint = keyring.require_own(package, public)
    if reason := register_of(session).barred(fingerprint):
        return PackagePlan(name, withdrawn=reason)
    artifacts, issued, warnings = identities.sign(session, package, documents, authorities, (key_pem, public), existing)
    new = {file: artifact.content for file, artifact in artifacts.items()}
    outliving = replaced_rights(session, package, existing, new)
    in_force = revocation_lists_in_force.enclave_lists(session).get(package.identity.issuer)
    for file, artifact in artifacts.items():
        if in_force and artifact.content == in_force:
            where = workspace.origin(folder / file)
            revocation_lists_in_force.require_nothing_lost(existing.get(file), in_force, where)
    paths = {workspace.shown(folder / file) for file in artifacts} if unreadable else set()
    in_place = [each for each in unreadable if each.where and each.where.file in paths]
    # Something that is not a regular file is in the place of an enclave's file.
    if blocking := [each for each in in_place if each.code in {"file-kind", "symlink-refused"}]:
        kept = Step(STAGE, name, Action.KEPT, detail="not updated")
        return PackagePlan(name, kept, diagnostics=tuple(blocking), lifetimes=own)
    files = {
        file: File(artifact.content, secret=artifact.secret, replaces_link=True) for file, artifact in artifacts.items()
    }
    different = new_files(session, folder, existing, files)
    # The certificate comes last: a node that starts in between fails, and admits nobody.
    ordered = dict(sorted(different.items(), key=lambda item: item[0] == CERTIFICATE))
    issuer = authorities[package.identity.issuer].certificate
    obsolete = _obsolete(session, package, {each: existing[each] for each in existing.keys() - files.keys()}, issuer)
    changes = (FolderChange(folder, ordered, obsolete, private=True),) if ordered or obsolete else ()
    action = (Action.UPDATED if existing else Action.CREATED) if changes else Action.UNCHANGED
    # Unreadable files that do not belong to the enclave are only reported; the others are replaced.
    foreign = [each for each in unreadable if each not in in_place]
    # Without a record of the build nothing is known about edits or staleness.
    is_recorded = session.state.stamp(BUILD, name) is not None
    build_types = build_types_of(session, package)
    copied = {file for each in build_types.values() for file in each.COPIED}
    edited = edits(session, name, documents) if is_recorded else ()
    made = _stamp(inputs, files, lifetimes=terms.dump(own, workspace))
    return PackagePlan(
        name,
        Step(STAGE, name, action, changes),
        made,
        (*warnings, *(replace(each, severity=Severity.WARNING) for each in foreign), *edited, *outliving),
        fingerprint=fingerprint,
        lifetimes=own,
        build_types=tuple(build_types),
        artifacts={file: artifacts[file] for file in copied if file in artifacts},
        outdated=is_recorded and not is_build_current(session, name),
        issued=issued,
        signed=_signed(session, package, new),
        rights=tuple(_changed_rights(session, package, documents)) if changes and existing else (),
    )


def _plan_shared(
    session: Session, chosen: Collection[str], authorities: Authorities, removed: Sequence[str]
) -> list[PackagePlan]:
    """Return the plans for the installed documents over all packages of each build type.

    Args:
        session: the workspace and its profile.
        chosen: the packages that this run installs.
        authorities: the authorities that sign, by name.
        removed: the enclaves that this run removes.

    Raises:
        KeymintError: the documents were not built or cannot be signed, or are stale although enclaves are removed.
    """
    planned: list[PackagePlan] = []
    for build_type, names in users(session).items():
        key = record_key(build_type)
        if is_built(session, key):
            planned.append(_plan_shared_documents(session, key, authorities, removed))
        elif not set(chosen).isdisjoint(names):
            raise _not_built(session, key, f"the shared documents of {build_type} are")
    return [*planned, *obsolete_documents(session, STAGE, session.workspace.install)]


def _plan_shared_documents(session: Session, key: str, authorities: Authorities, removed: Sequence[str]) -> PackagePlan:
    stale: list[Diagnostic] = []
    if not is_build_current(session, key):
        paths = (documents_folder(session, key) / path for path in session.state.stamps[BUILD][key].outputs)
        where = next(map(session.workspace.origin, paths), None)
        if removed:
            raise KeymintError(
                f"is stale, and may still have the rights of {subject_of(removed[0])}, whose enclave is to be removed",
                where=where,
                help="run 'keymint build' first",
                code=OUTDATED,
            )
        stale.append(Diagnostic.warning(OUTDATED, _STALE, where, "'keymint build' rebuilds it"))
    if is_current(session, key):
        return PackagePlan(key, diagnostics=tuple(stale))
    documents, install = built_documents(session, key), session.workspace.install
    artifacts, existing = sign_shared(session, shared_type(key), documents, authorities)
    stamp = session.state.stamp(STAGE, key)
    files = {path: File(artifact.content, secret=artifact.secret) for path, artifact in artifacts.items()}
    former = set(stamp.outputs if stamp else ()) - files.keys()
    written = by_folder(install, new_files(session, install, existing, files))
    changes = (*removals(session, install, former), *(FolderChange(*each) for each in written.items()))
    action = Action.UPDATED if existing else Action.CREATED
    made = _stamp(inputs_of(session, key) or "", files, build_types=(shared_type(key),))
    step = Step(STAGE, "", action, changes, f"{', '.join(documents)}, for all enclaves")
    diagnostics = (*stale, *edits(session, key, documents))
    name = shared_type(key)
    found = (_changed_rights(session, each, documents, name) for each in load_packages(session, name) if existing)
    rights = tuple(chain.from_iterable(found)) if changes else ()
    return PackagePlan(key, step if changes else None, made, diagnostics, rights=rights)


def _stamp(inputs: str, files: Mapping[str, File], lifetimes: str = "", build_types: tuple[str, ...] = ()) -> Stamp:
    outputs = {file: item.digest for file, item in files.items()}
    secret = tuple(file for file, item in files.items() if item.secret)
    return Stamp(inputs, outputs, secret, lifetimes=lifetimes, build_types=build_types)


def _not_built(session: Session, name: str, what: str) -> KeymintError:
    """Return the error for a package, or documents over all packages, that must be built before, or lacks its key."""
    if not shared_type(name) and is_built(session, name) and known_fingerprint(session, name):
        return identities.missing_key(session, name)
    command = "keymint build" if shared_type(name) else f"keymint build {name}"
    where = session.workspace.origin(documents_folder(session, name))
    return KeymintError(f"{what} not built", help=f"run '{command}'", code="not-built", where=where)


def _signed(session: Session, package: Package, files: Mapping[str, bytes]) -> tuple[SignedRights, ...]:
    """Return the documents of an enclave that its holder presents, for the register."""
    subject = to_text(certificates.load(files[CERTIFICATE]).subject)
    return tuple(workspace_register.rights_of(package, build_types_of(session, package).values(), files, subject))


def _obsolete(
    session: Session, package: Package, left: Mapping[str, bytes], issuer: x509.Certificate
) -> tuple[str, ...]:
    """Return those files of an enclave that were installed and are not any more: they would still have effect.

    Raises:
        KeymintError: one is a revocation list, and what it revokes would be accepted again.
    """
    stamp = session.state.stamp(STAGE, package.name)
    obsolete = tuple(file for file in sorted(stamp.outputs) if file in left) if stamp else ()
    for file in (each for each in obsolete if not revocation_lists.problem(left[each], issuer)):
        in_force = revocation_lists_in_force.lists(session).get(package.identity.issuer)
        where = session.workspace.origin(session.enclave(package.name) / file)
        revocation_lists_in_force.require_nothing_lost(left[file], in_force, where)
    return obsolete


def _awaiting(session: Session, package: Package) -> PackagePlan:
    """Return the plan for a package whose robot has not yet told its public key: its enclave stays, unless revoked."""
    if package.name in enclave_names(session) and (reason := register_of(session).withdrawn(package.name)):
        return PackagePlan(package.name, withdrawn=reason)
    kept = Step(STAGE, package.name, Action.KEPT, detail="waits for a request of its robot")
    diagnostics = (identities.unknown_key(package),)
    return PackagePlan(package.name, kept, diagnostics=diagnostics, lifetimes=terms.lifetimes(package))


def _outdated(inputs: Inputs, names: Sequence[str]) -> Iterator[Diagnostic]:
    """Yield one warning for all packages whose build is stale; they often have one cause."""
    one = len(names) == 1
    for name in names[:1]:
        yield Diagnostic.warning(
            OUTDATED,
            _STALE + ("" if one else f" [{len(names)} packages]"),
            inputs.workspace.origin(inputs.workspace.build / name),
            f"'keymint build {name}' rebuilds it" if one else "'keymint build' rebuilds all stale packages",
            subject_of(name) if one else "",
        )


def is_current(session: Session, name: str) -> bool:
    """Tell whether installing a package, or shared documents, again would change no byte and no mode."""
    stamp = session.state.stamp(STAGE, name)
    folder = str(session.workspace.install) if shared_type(name) else session.enclave_folder(name)
    return stamp is not None and stamp.inputs == inputs_of(session, name) and has_outputs(session, folder, stamp)


def would_stay(session: Session, name: str, authorities: Authorities) -> bool:
    """Tell whether installing an enclave again would change nothing, e.g. as a list changed that it does not have.

    Args:
        session: the workspace and its profile, with these authorities.
        name: the package.
        authorities: the authorities that issue and sign, by name.

    Raises:
        KeymintError: it cannot be installed.
    """
    planned = InstallStage(session, authorities, prune=False).package(name)
    require_none(planned.errors)
    return planned.step is not None and planned.step.action is Action.UNCHANGED and not planned.outdated


def inputs_of(session: Session, name: str) -> str | None:
    """Return the digest of all that an enclave, or shared documents, are made from, or None if that is not built."""
    documents, shared = document_digests(session, name), shared_type(name)
    key = "" if shared else identities.key_digest(session, name)
    if documents is None or key is None:
        return None
    return _inputs(session, inputs_digest(session, name), key, documents, is_shared=bool(shared))


def _inputs(session: Session, built: str, key: str, documents: Mapping[str, str], *, is_shared: bool = False) -> str:
    """Return the digest of :func:`inputs_of` from that of what the documents are built from, and those of the files."""
    parts = chain.from_iterable(sorted(documents.items()))
    revoked = {} if is_shared else revocation_lists_in_force.lists(session)
    more = (digest_files(revoked),) if revoked else ()
    return digest_of_texts(built, key, chains_digest(session), session.profile.layout, *parts, *more)
