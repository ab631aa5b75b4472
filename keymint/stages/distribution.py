# SPDX-License-Identifier: Apache-2.0
"""Put new revocation lists into the installed enclaves, and change nothing else in them.

That needs no sources, no build and no signature, so a defect of one package does not keep a revocation from the others.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace
from pathlib import Path

from keymint.authority.authority_files import trusted_chains
from keymint.life.revocation_lists_in_force import enclave_lists, require_nothing_lost
from keymint.pki import certificates
from keymint.stages import install
from keymint.store.changes import Action, File, FolderChange, Plan, Step
from keymint.view.stamps import Stamp
from keymint.workspace.installed_enclaves import INSTALLED, installed, installed_certificate
from keymint.workspace.package_build_types import recorded_build_types, revocation_files
from keymint.workspace.session import Session, once


def plan_distribution(before: Session, session: Session, omitted: Collection[str]) -> Plan:
    """Plan the revocation lists of all installed enclaves.

    Args:
        before: the workspace with the lists of the last installation.
        session: the workspace with the lists in force.
        omitted: enclaves that are left as they are.
    """
    in_force = enclave_lists(session)
    if not in_force:
        return Plan((), session.state)
    issuers = {name: certificates.load_bundle(chain)[0] for name, chain in trusted_chains(session).items() if chain}
    steps: list[Step] = []
    stamps: dict[str, Stamp] = {}
    for name in installed(session):
        if name in omitted:
            continue
        folder = session.enclave(name)
        build_types = recorded_build_types(session, name)
        possible = {authority: _files(session, build_types, content) for authority, content in in_force.items()}
        if len(possible) == 1 and not any(_different(session, folder, files) for files in possible.values()):
            continue  # nobody else's list could be in force, so the certificate need not be read
        certificate = installed_certificate(session, name)
        files: dict[str, File] = {}
        for authority, of_list in possible.items():
            issuer = issuers.get(authority)
            if certificate and issuer and certificates.is_issued_by(certificate, issuer):
                files |= of_list
        different = _different(session, folder, files)
        if not different:
            continue
        for file, item in different.items():
            where = session.workspace.origin(folder / file)
            require_nothing_lost(session.tree.try_read(f"{folder}/{file}"), item.content, where)
        steps.append(Step(INSTALLED, name, Action.UPDATED, (FolderChange(folder, different),), "revocation list"))
        stamp = session.state.stamp(INSTALLED, name)
        if stamp is not None:
            outputs = {**stamp.outputs, **{file: item.digest for file, item in files.items()}}
            current = install.is_current(before, name)
            inputs = install.inputs_of(session, name) if current else None
            stamps[name] = replace(stamp, outputs=outputs, inputs=inputs or stamp.inputs)
    return Plan(tuple(steps), session.state.updated(INSTALLED, stamps))


def _different(session: Session, folder: Path, files: Mapping[str, File]) -> dict[str, File]:
    """Return the files that a folder does not have with this content."""
    return {file: item for file, item in files.items() if session.tree.digest(f"{folder}/{file}") != item.digest}


@once
def _files(session: Session, build_types: tuple[str, ...], revocations: bytes) -> dict[str, File]:
    """Return the files of a list by name, as the transports read them."""
    found = (session.plugins.build_type(name, session.profile_marker()) for name in build_types)
    artifacts = revocation_files(found, session.profile.distro, session.profile.layout, revocations)
    return {file: File(artifact.content) for file, artifact in artifacts}
