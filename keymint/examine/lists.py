# SPDX-License-Identifier: Apache-2.0
"""Judge revocation lists: each enclave has the one in force, it has all revocations, and it revokes nobody else."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from comarmor.errors import Diagnostic, Origin
from comarmor.text import counted, first_few
from keymint.authority.authority_files import issuers
from keymint.errors import KeymintError
from keymint.examine.issued import issued_here
from keymint.life.revocation_lists_in_force import enclave_lists
from keymint.life.workspace_register import issuer_of, register_of
from keymint.names import subject_of
from keymint.pki import revocation_lists
from keymint.workspace.installed_enclaves import enclave_files, with_sources
from keymint.workspace.package_build_types import build_types_of, is_build_current, revocation_files
from keymint.workspace.session import Session, once

_INSTALL = "'keymint install' writes it again; then deploy and restart the enclaves"


def lists_in_force(session: Session) -> Iterator[Diagnostic]:
    """Yield a finding for each authority whose list lacks a revocation of the register, or revokes what is in force."""
    register = register_of(session)
    for name, _, issuer in issuers(session):  # others are reported with the authorities
        path = session.workspace.revocation_list(name)
        where = session.workspace.origin(path)
        revoked = {each.serial: each.name for each in register.revoked(issuer_of(issuer))}
        content = session.tree.read(path)
        try:
            listed = () if content is None else revocation_lists.load(content, where).revocations
        except KeymintError as error:
            yield from error.diagnostics
            continue
        if lacking := revoked.keys() - {each.serial for each in listed}:
            what = "is missing" if content is None else "is not the latest revocation list"
            message = f"{what}: {counted(len(lacking), 'revoked certificate')} would be accepted"
            yield Diagnostic.error("revocation-list-outdated", message, where, _INSTALL)
        if content is not None and not revocation_lists.problem(content, issuer):
            yield from _living(session, content, where)


def of_enclaves(session: Session) -> Iterator[Diagnostic]:
    """Yield a finding for each installed enclave with another revocation list than the one in force.

    Raises:
        KeymintError: a package has defects.
    """
    in_force, accepted = enclave_lists(session), _accepted(session)
    for name in with_sources(session):
        package, files = session.package(name, built=is_build_current(session, name)), enclave_files(session, name)[0]
        build_types, layout = build_types_of(session, package).values(), session.profile.layout
        expected = in_force.get(package.identity.issuer, b"")
        folder = session.workspace.shown(session.enclave_folder(name))
        for file, artifact in revocation_files(build_types, package.distro, layout, expected or b"list"):
            where = Origin(f"{folder}/{file}")
            if expected and files.get(file) != artifact.content:
                what = "is not the revocation list in force" if file in files else "the revocation list is missing"
                thieves = accepted.get(package.identity.issuer, ())
                whom = f"the revoked {first_few(thieves)}" if thieves else "revoked certificates"
                message = f"{what}: {package.subject} accepts {whom}"
                help_ = f"'keymint install {name}' writes it; then deploy and restart the enclave"
                yield Diagnostic.error("revocation-list-outdated", message, where, help_, package.subject)
            if file in files and files[file] != expected:
                yield from _living(session, files[file], where, package.subject)


def _living(session: Session, pem: bytes, where: Origin, subject: str = "") -> Iterator[Diagnostic]:
    """Yield a finding if a list by an authority of the workspace revokes a certificate that is in force."""
    crl = revocation_lists.first(pem)
    found = [issuer for _, _, issuer in issuers(session) if crl is not None and revocation_lists.is_by(crl, issuer)]
    if crl is None or not found:
        return  # of a foreign one the checks of credentials tell
    serials = {entry.serial_number for entry in crl}
    names = sorted(
        {name for issuer, serial, name in _in_force(session) if issuer == issuer_of(found[0]) and serial in serials}
    )
    if names:
        message = f"revokes the certificate of {first_few(names)}, which the register does not have as revoked"
        help_ = f"'keymint revoke' revokes it; else remove this list, and {_INSTALL}"
        yield Diagnostic.error("revocation-list-living", message, where, help_, subject)


@once
def _in_force(session: Session) -> frozenset[tuple[str, int, str]]:
    """Return issuer, serial number and subject of each certificate that is not revoked: registered, or installed."""
    register = register_of(session)
    known = {
        (each.issuer, each.serial, subject_of(each.name))
        for each in register.certificates.values()
        if each.revoked is None and each.not_after >= session.now
    }
    for name, certificate, issuer in issued_here(session):
        key = issuer_of(issuer), certificate.serial_number
        if not register.is_revoked(*key):
            known.add((*key, subject_of(name)))
    return frozenset(known)


def _accepted(session: Session) -> Mapping[str, list[str]]:
    """Return the subjects whose certificates were revoked and have not ended, by the name of their authority."""
    found: dict[str, dict[str, None]] = {}
    for _, name, issuer in issuers(session):
        for each in register_of(session).revoked(issuer_of(issuer)):
            if each.not_after >= session.now:
                found.setdefault(name, {})[subject_of(each.name) if each.name else f"certificate {each.serial:x}"] = (
                    None
                )
    return {name: sorted(subjects) for name, subjects in found.items()}
