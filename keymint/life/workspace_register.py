# SPDX-License-Identifier: Apache-2.0
"""The register of a workspace: read, written with what a run issues, and restored from what is installed."""

from __future__ import annotations

import contextlib
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from datetime import datetime
from functools import lru_cache
from itertools import chain

from cryptography import x509

from comarmor.text import quantity
from keymint.api import BuildType, Package
from keymint.authority import authority_files
from keymint.errors import KeymintError, Origin
from keymint.life.register import UNKNOWN, IssuedCertificate, Register, SignedRights, loaded_register, register_content
from keymint.names import subject_of
from keymint.pki import certificates, keys, revocation_lists, smime
from keymint.pki.distinguished_names import to_text
from keymint.pki.revocation_lists import RevocationList
from keymint.store.changes import FolderChange, secret_file
from keymint.workspace.installed_enclaves import enclave_files, enclave_names, installed_certificate, with_sources
from keymint.workspace.package_build_types import build_types_of, revocation_files
from keymint.workspace.session import Inputs, Session, once


@once
def register_of(session: Session) -> Register:
    """Return the register of a workspace as it is on the disk; empty if there is none.

    Raises:
        KeymintError: it is damaged.
    """
    path = session.workspace.register
    content = session.tree.read(path)
    return Register() if content is None else loaded_register(content, session.workspace.origin(path))


def has_register(inputs: Inputs) -> bool:
    """Tell whether the register is here and was read: without it, revocations are not known."""
    path = inputs.workspace.register
    return inputs.tree.has_file(path) and not inputs.tree.is_left_out(path)


@once
def withdrawn(session: Session) -> Mapping[str, str]:
    """Return the packages whose certificate was revoked and whose enclave is gone, each with the reason.

    Raises:
        KeymintError: the register is damaged; or it may not be read, and the sources of a package have defects.
    """
    register, there = register_of(session), frozenset(enclave_names(session))
    gone = [name for name in session.packages() if name not in there]
    if not has_register(session):  # each revocation raises the generation in the sources
        return {name: "for a reason that is not known" for name in gone if session.issuance(name).generation}
    found = {name: register.withdrawn(name) for name in gone}
    return {name: reason for name, reason in found.items() if reason}


def with_enclaves(session: Session, names: Sequence[str], *, named: bool) -> tuple[str, ...]:
    """Return packages without those whose certificate was revoked and whose enclave is gone, unless a user named them.

    Args:
        session: the workspace and its profile.
        names: the packages.
        named: a user named them; else they are all that there are.
    """
    return tuple(names) if named else tuple(name for name in names if name not in withdrawn(session))


def complete_register(session: Session, names: Collection[str] = (), *, lossy: bool = False) -> Register:
    """Return the register, restored from the installed certificates and revocation lists if there is none.

    Args:
        session: the workspace and its profile.
        names: packages whose installed certificate is added if the register lacks it, because it is an old one.
        lossy: restore it although revocations cannot be accounted for.

    Raises:
        KeymintError: it is damaged; or there is none, and a revocation cannot be accounted for.
    """
    if session.tree.read(session.workspace.register) is None:
        return _restored(session, lossy=lossy)
    register = register_of(session)
    if not (register.rights or register.is_whole):
        register = register.with_rights(_rights_found(session))
    found = _found(session, names) if names else ()
    missing = [each for each in found if (each.issuer, each.serial) not in register.certificates]
    return register.with_issued(missing) if missing else register


def rights_of(
    package: Package, build_types: Iterable[BuildType], files: Mapping[str, bytes], subject: str
) -> Iterator[SignedRights]:
    """Yield the signed documents of an enclave that its holder presents.

    Args:
        package: the package.
        build_types: its build types.
        files: the files of the enclave by name.
        subject: distinguished name of its certificate, in certificate order.
    """
    for each in build_types:
        presentation = each.presentation
        if presentation and presentation.FILE in files:
            with contextlib.suppress(KeymintError):  # nobody accepts what has no signature
                content = smime.signed_content(files[presentation.FILE])
                validity = None if package.kept else package.grant.validity
                if end := validity.not_after if validity else presentation.presented_until(content):
                    yield SignedRights.of(package.name, package.issuance.generation, subject, end, content)


def _rights_found(session: Session) -> Iterator[SignedRights]:
    """Yield the signed documents of the installed enclaves."""
    for name in with_sources(session):
        certificate = installed_certificate(session, name)
        with contextlib.suppress(KeymintError):  # reported with the package
            package, files = session.package(name), enclave_files(session, name)[0]
            if certificate is not None:
                subject = to_text(certificate.subject)
                yield from rights_of(package, build_types_of(session, package).values(), files, subject)


def register_change(session: Session, register: Register) -> tuple[FolderChange, ...]:
    """Return what writes a register, if it differs from the one on the disk."""
    is_same = register == register_of(session)
    return () if is_same else (secret_file(session.workspace.register, register_content(register)),)


@lru_cache(maxsize=64)
def issuer_of(authority: x509.Certificate) -> str:
    """Return what identifies an issuer in the register: the fingerprint of its public key."""
    return certificates.fingerprint(authority)


def entry_of(
    certificate: x509.Certificate,
    issuer: str,
    authority: str,
    name: str,
    generation: int,
    rights: str = "",
    issued: datetime | None = None,
) -> IssuedCertificate:
    """Return the entry of a certificate for the register.

    Args:
        certificate: the certificate.
        issuer: what :func:`issuer_of` returns for its issuer.
        authority: name of its issuer.
        name: the package.
        generation: its generation.
        rights: digest of the package's documents; empty if it is not known.
        issued: when it was issued; None if that is not known.
    """
    serial, key = certificate.serial_number, certificates.fingerprint(certificate)
    period = certificates.period(certificate)
    return IssuedCertificate(issuer, serial, authority, name, generation, *period, key, rights, issued=issued)


def _restored(session: Session, *, lossy: bool) -> Register:
    """Return a register of what is installed.

    Raises:
        KeymintError: a package was revoked, but no list has a serial number of it, or the certificate with this number
            is not known; then it is not known which key must not be certified again.
    """
    there, tree = enclave_names(session), session.tree
    files = {name: f"{session.workspace.src}/{name}/{session.package_type.ISSUANCE}" for name in session.packages()}
    decided = [name for name, file in files.items() if tree.has_file(file) or tree.status(file)]  # new ones have none
    lost = [name for name in decided if session.issuance(name).generation]
    register = Register(is_whole=not (there or lost)).with_issued(_found(session, there))
    register = register.with_rights(_rights_found(session))
    gone = frozenset(lost).difference(there) if lossy else ()
    register = register.with_issued(_barred(session, number, name) for number, name in enumerate(sorted(gone), 1))
    for file, name, authority in authority_files.issuers(session):
        path, issuer = session.workspace.revocation_list(file), issuer_of(authority)
        found = [each for _, each in installed_lists(session, authority)]
        if content := session.tree.read(path):
            found.append(revocation_lists.load(content, session.workspace.origin(path)))
        for number in (each.number for each in found):
            register = register.with_number(issuer, number or 1)
        for each in chain.from_iterable(each.revocations for each in found):
            known = register.certificates.get((issuer, each.serial))
            if known is None:
                known = IssuedCertificate(issuer, each.serial, name, "", 0, each.at, each.at, "")
                register = register.with_issued([known])
            register = register.with_revoked([known], each.reason, each.at)
    unknown = [each for each in register.certificates.values() if not each.name]
    if (lost or unknown) and not lossy:
        who = f"/{lost[0]}" if lost else quantity(len(unknown), "certificate")
        raise KeymintError(
            f"the register of issued certificates is missing, and {who} had been revoked: which keys is not known",
            where=session.workspace.origin(session.workspace.register),
            help="restore it from a backup; or 'keymint crl --rebuild' makes it again: what the revocation lists here "
            "have stays revoked, and packages that were revoked and have no enclave need 'keymint renew --rekey'; "
            "other keys that were revoked as compromised may be certified again",
            code="register-lost",
        )
    return register


def _barred(session: Session, number: int, name: str) -> IssuedCertificate:
    """Return an entry that bars the key of a package that was revoked: which certificate and why is not known.

    Raises:
        KeymintError: the key cannot be read.
    """
    own, path = session.issuance(name), session.workspace.identity_key(name)
    pem = session.tree.read(path)
    key = keys.fingerprint_of_file(pem) if pem else ""
    if own.public_key:
        key = keys.fingerprint(keys.public_from_pem(own.public_key, session.package_marker(name)))
    at = session.now
    return IssuedCertificate("", number, "", name, own.generation - 1, at, at, key, revoked=at, reason=UNKNOWN)


def installed_lists(session: Session, authority: x509.Certificate) -> Iterator[tuple[Origin, RevocationList]]:
    """Yield the different revocation lists of an authority that enclaves have, each with one of its files."""
    profile, found = session.profile, dict[bytes, str]()
    files = dict(revocation_files(session.build_types.values(), profile.distro, profile.layout, b"list"))
    for name in enclave_names(session):
        for file in files:
            path = f"{session.enclave_folder(name)}/{file}"
            found.setdefault(session.tree.try_read(path) or b"", path)
    for content, path in found.items():
        if not revocation_lists.problem(content, authority):
            where = session.workspace.origin(path)
            yield where, revocation_lists.load(content, where)


def outdated_register(session: Session, lacks: str) -> KeymintError:
    """Return the error for a register that is older than a revocation, of which it does not know."""
    return KeymintError(
        f"does not know {lacks}",
        where=session.workspace.origin(session.workspace.register),
        help="restore the latest register from a backup; or remove it, and 'keymint crl --rebuild' makes it again",
        code="register-outdated",
    )


def _found(session: Session, names: Collection[str]) -> Iterator[IssuedCertificate]:
    """Yield an entry for the installed certificate of each package that one of the workspace's authorities issued."""
    issuers = [(authority, issuer) for _, authority, issuer in authority_files.issuers(session)]
    known = frozenset(session.packages())
    for name in names:
        certificate = installed_certificate(session, name)
        for authority, issuer in issuers:
            if certificate is not None and certificates.is_issued_by(certificate, issuer):
                generation = session.issuance(name).generation if name in known else 0
                yield entry_of(certificate, issuer_of(issuer), authority, name, generation)
                break


def require_free_serials(register: Register, issued: Iterable[IssuedCertificate]) -> None:
    """Require that no serial number is given to two certificates of an issuer (RFC 5280, 4.1.2.2).

    Raises:
        KeymintError: two certificates have one.
    """
    taken: dict[tuple[str, int], IssuedCertificate] = {}
    for each in issued:
        other = taken.setdefault((each.issuer, each.serial), each)
        other = other if other is not each else register.certificates.get((each.issuer, each.serial), each)
        if (other.name, other.key, other.not_before, other.not_after) != (
            each.name, each.key, each.not_before, each.not_after,
        ):  # fmt: skip
            raise KeymintError(
                f"the serial number {each.serial} of {subject_of(each.name)} was given to a certificate of "
                f"{subject_of(other.name)} before",
                help="leave <serial_number> empty for a random one",
                code="serial-taken",
            )
