# SPDX-License-Identifier: Apache-2.0
"""Check the revocation lists: each enclave has the one in force, which has all revocations of the register."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from comarmor.errors import Diagnostic, Origin
from comarmor.text import counted
from keymint.api import Package
from keymint.errors import KeymintError
from keymint.pki import revocation_lists
from keymint.plan.authority_files import issuers
from keymint.plan.build_types import build_types_of, revocation_files
from keymint.plan.register import issuer_of, register_of
from keymint.plan.revocation import enclave_lists
from keymint.session import Session

_INSTALL = "'keymint install' writes it again; then deploy and restart the enclaves"


def lists_in_force(session: Session) -> Iterator[Diagnostic]:
    """Yield a finding for each authority whose list lacks a revocation of the register, or that has no list."""
    register = register_of(session)
    for name, _, issuer in issuers(session):  # others are reported with the authorities
        path = session.workspace.revocation_list(name)
        where = session.workspace.origin(path)
        revoked = {each.serial for each in register.revoked(issuer_of(issuer))}
        content = session.tree.read(path)
        try:
            listed = () if content is None else revocation_lists.load(content, where).revocations
        except KeymintError as error:
            yield from error.diagnostics
            continue
        if lacking := revoked.difference(each.serial for each in listed):
            what = "is missing" if content is None else "is not the latest revocation list"
            message = f"{what}: {counted(len(lacking), 'revoked certificate')} would be accepted"
            yield Diagnostic.error("revocation-list-outdated", message, where, _INSTALL)


def of_enclave(session: Session, package: Package, files: Mapping[str, bytes]) -> Iterator[Diagnostic]:
    """Yield a finding if an enclave does not have the revocation list in force.

    Args:
        session: the workspace and its profile.
        package: the package.
        files: the enclave's files by name.
    """
    in_force = enclave_lists(session).get(package.identity.issuer)
    if not in_force:
        return
    folder, layout = session.workspace.shown(session.enclave_folder(package.name)), session.profile.layout
    help_ = f"'keymint install {package.name}' writes it; then deploy and restart the enclave"
    for file, artifact in revocation_files(build_types_of(session, package).values(), package.distro, layout, in_force):
        if files.get(file) != artifact.content:
            what = "is not the revocation list in force" if file in files else "the revocation list is missing"
            message = f"{what}: revoked certificates are accepted"
            where = Origin(f"{folder}/{file}")
            yield Diagnostic.error("revocation-list-outdated", message, where, help_, package.subject)
