# SPDX-License-Identifier: Apache-2.0
"""Plan the workspace that a keystore of another tool becomes.

The plan is carried on to the build and the installation that would follow. They must change nothing that the robots
have; if they would, nothing is written.
"""

from __future__ import annotations

import posixpath
import stat
from collections.abc import Mapping
from functools import partial
from pathlib import Path

from comarmor.values import Data, replace
from keymint import api
from keymint.adoption.keystore_policy import AdoptedPolicy
from keymint.authority.authority_changes import GivenAuthority, plan_import
from keymint.errors import Diagnostic, KeymintError, Origin, require_none
from keymint.ir import SubjectRules
from keymint.life.workspace_register import complete_register, register_change
from keymint.names import package_name
from keymint.pki import certificates, keys
from keymint.stages.create import marker_last, plan_init, refuse_unsupported
from keymint.stages.pipeline import INSTALL, Request, conduct
from keymint.stages.work import Crew, InstallRequest, Work
from keymint.store.changes import Action, File, FolderChange, Plan, Step, folder_changes, secret_file
from keymint.workspace.package_build_types import BUILD
from keymint.workspace.policy_loading import record_policy
from keymint.workspace.session import Inputs, Session
from keymint.workspace.workspace import DEFAULTS

STAGE = "adopt"


class Adoption(Data):
    """A keystore to take over.

    Attributes:
        reader: reads it.
        files: its files.
        found: what it has.
        policy: its policy.
        profile_type: name of the type of the new profile.
        request: the new profile.
    """

    reader: api.KeystoreReader
    files: api.KeystoreFiles
    found: api.FoundKeystore
    policy: AdoptedPolicy
    profile_type: str
    request: api.Bootstrap


def plan_adoption(inputs: Inputs, adoption: Adoption, crew: Crew) -> Plan:
    """Plan the workspace, its build and its installation.

    Args:
        inputs: a workspace that does not exist yet.
        adoption: what becomes of it.
        crew: who plans packages.

    Raises:
        KeymintError: something cannot be taken over as it is; with all reasons.
    """
    # The marker of the profile stays the last file to be written, also with the policy and the defaults.
    plan = plan_init(inputs, adoption.profile_type, adoption.request)
    (step,) = plan.steps
    *folders, root = step.changes
    defaults = {f"{DEFAULTS}/{part}.xml": content for part, content in adoption.found.defaults.items()}
    changes = folder_changes(inputs.tree, inputs.workspace.profile, {**adoption.policy.files, **defaults})
    profile = replace(plan, steps=(replace(step, changes=(*folders, *changes, root)),))
    work = Work.after(inputs, profile)
    refuse_unsupported(work.session)
    for authority in adoption.found.authorities:
        place = Origin(f"{adoption.files.folder}/{authority.file}")
        key_place = Origin(f"{adoption.files.folder}/{next(iter(authority.key_files), '')}")
        given = GivenAuthority(authority.certificate, place, authority.key, key_place, authority.exposed)
        work = work.then(plan_import(work.session, authority.name, given))
    for planned in (_sources, _keystore, _lists, _register):
        work = work.then(planned(work.session, adoption))
    request = Request(
        [package_name(each.subject) for each in adoption.found.enclaves],
        options=InstallRequest(prove=False, build=api.BuildOptions()),
        follow=False,
        late=True,
        adopts=True,
        checks={BUILD: partial(_require_kept, adoption), INSTALL: partial(_require_unchanged, adoption)},
    )
    work = conduct(work, request, crew)
    # From now on, each stage compares the packages with the policy.
    # The policy is not in its place yet: no file has this fingerprint, so its files count as changed.
    unread = {source.path: b"\0" for source in work.session.profile.policies}
    return work.recording(record_policy(work.session, unread, adoption.policy.subjects)).plan


# -- sources ------------------------------------------------------------------------------------------------------


def _sources(session: Session, adoption: Adoption) -> Plan:
    """Plan the source package and the private key of each enclave."""
    package_type = session.package_type
    own_domain = (api.DomainRange(adoption.request.domain, adoption.request.domain),)
    steps = []
    for enclave in adoption.found.enclaves:
        name = package_name(enclave.subject)
        key, validity, granted = enclave.key_spec, enclave.validity, enclave.grant_validity
        if key is None or validity is None or granted is None:
            raise KeymintError(
                f"the enclave {enclave.subject} has no usable certificate or permissions",
                where=Origin(f"{adoption.files.folder}/{enclave.facts['place']}"),
                help="'keymint adopt' without --apply says what is wrong", code="adopt-incomplete",
            )  # fmt: skip
        sources = api.AdoptedSources(
            rules=adoption.policy.rules.get(enclave.subject, SubjectRules(enclave.subject, ())),
            subject_name="" if adoption.found.subject_format else enclave.subject_name,
            validity=validity,
            grant_validity=granted,
            domains=() if enclave.domains == own_domain else enclave.domains,
            key=key,
            documents=enclave.documents,
        )
        certificate = certificates.load(enclave.certificate)
        public = b"" if enclave.key else keys.public_to_pem(certificates.public_key(certificate))
        decided = api.Issuance(
            public_key=public,
            certificate=certificates.to_pem(certificate),
            exposed=certificates.fingerprint(certificate) if enclave.exposed else "",
        )
        described = package_type.adopted_sources(session.profile, sources)
        if described is None or not package_type.ISSUANCE:
            raise KeymintError(
                f"packages of the type {session.profile.package_type!r} cannot describe what another tool made",
                where=session.profile_marker(), help="use the profile type keymint_ros", code="adopt-unsupported",
            )  # fmt: skip
        files = {**package_type.with_issuance(decided), **described}
        changes = [FolderChange(session.workspace.src / name, marker_last(package_type, files))]
        if enclave.key:
            changes.append(secret_file(session.workspace.identity_key(name), enclave.key))
        steps.append(Step(STAGE, name, Action.CREATED, tuple(changes)))
    return Plan(tuple(steps), session.state)


# -- what the robots have -----------------------------------------------------------------------------------------


def _keystore(session: Session, adoption: Adoption) -> Plan:
    """Plan the copy of what the robots have; what is secret is 0600 whatever its mode was.

    A link stays one if it leads to a file that is kept too; any other one becomes the file that it leads to.
    """
    folders: dict[Path, dict[str, File]] = {}
    kept = frozenset(adoption.found.kept)
    for target, path in _copies(session, adoption).items():
        file = adoption.files.files[path]
        # No folder of a keystore is a link.
        leads_to = posixpath.normpath(posixpath.join(posixpath.dirname(path), file.link)) if file.link else ""
        link = file.link if leads_to in kept else ""
        folders.setdefault(target.parent, {})[target.name] = File(file.content, secret=_is_secret(file), link=link)
    changes = tuple(FolderChange(folder, files) for folder, files in sorted(folders.items()))
    return Plan((Step(STAGE, "", Action.CREATED, changes, "the keystore as it was found"),), session.state)


def _lists(session: Session, adoption: Adoption) -> Plan:
    """Plan the revocation lists that the authorities go on with."""
    steps = []
    for name, content in adoption.found.revocation_lists.items():
        path = session.workspace.revocation_list(name)
        change = FolderChange(path.parent, {path.name: File(content)})
        steps.append(Step(STAGE, name, Action.CREATED, (change,), "revocation list"))
    return Plan(tuple(steps), session.state)


def _register(session: Session, adoption: Adoption) -> Plan:
    """Plan a register with what the lists revoke; without one it is made when something is issued."""
    if not adoption.found.revocation_lists:
        return Plan((), session.state)
    return Plan((), session.state, first=register_change(session, complete_register(session, lossy=True)))


def _is_secret(file: api.KeystoreFile) -> bool:
    """Tell whether a file has a private key, or may have one in a form that is not read: its owner hides it."""
    try:
        is_text = "\0" not in file.content.decode()
    except UnicodeDecodeError:
        is_text = False
    is_hidden = not file.mode & stat.S_IROTH
    return keys.has_private_key(file.content) or (is_hidden and not is_text)


def _copies(session: Session, adoption: Adoption) -> Mapping[Path, str]:
    """Return the files that robots have: places in the install space, each with its path in the keystore."""
    found, install = adoption.found, session.workspace.install
    if found.kept:
        return {install / path: path for path in found.kept}
    return {
        session.enclave(package_name(enclave.subject)) / name: path
        for enclave in found.enclaves
        for name, path in enclave.files.items()
    }


def _require_kept(adoption: Adoption, built: Work) -> None:
    """Require that the build gives the documents that are signed.

    Raises:
        KeymintError: it does not; says why.
    """
    session = built.session
    errors: list[Diagnostic] = []
    for enclave in adoption.found.enclaves:
        name = package_name(enclave.subject)
        for document, content in enclave.documents.items():
            if session.tree.read(session.workspace.build / name / document) == content:
                continue
            why = adoption.reader.not_kept(session.package(name), document, content)
            message = f"cannot be kept as it is signed: {why or 'its rules cannot be written in the same way'}"
            place = f"{adoption.files.folder}/{enclave.facts['place']}/{document}"
            help_ = "sign it again with the tool that made it, without what is in the way"
            errors.append(Diagnostic.error("adopt-not-kept", message, Origin(place), help_, enclave.subject))
    require_none(errors)


def _require_unchanged(adoption: Adoption, installed: Work) -> None:
    """Require that the installation changes no file that the robots have.

    Raises:
        KeymintError: it would; names each such file.
    """
    copies = {str(target): path for target, path in _copies(installed.session, adoption).items()}
    message = "would be changed by 'keymint install', so it is not taken over"
    help_ = "make it what the other enclaves have, or leave the file out if nothing reads it"
    errors: list[Diagnostic] = []
    for folder, written, removed in installed.of(INSTALL).names():
        for name in (*written, *removed):
            if path := copies.get(posixpath.join(folder, name)):
                where = Origin(f"{adoption.files.folder}/{path}")
                errors.append(Diagnostic.error("adopt-not-kept", message, where, help_))
    require_none(errors)
