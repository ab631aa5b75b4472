# SPDX-License-Identifier: Apache-2.0
"""Changes of one authority: issued again with later dates, taken from outside, or its stored key encrypted."""

from __future__ import annotations

from dataclasses import field, replace
from datetime import datetime

from cryptography import x509

from comarmor.errors import Diagnostic, Origin
from comarmor.values import dataclass
from keymint.api import Authority, AuthorityIssuance, Validity
from keymint.authority import authority_files
from keymint.authority.authorities import (
    STAGE,
    MintedAuthority,
    authority_named,
    only_in_token,
    plan_authorities,
    plan_authority_issuance,
)
from keymint.errors import KeymintError
from keymint.pki import certificates, distinguished_names, foreign_authorities, keys, periods
from keymint.store.changes import Action, FolderChange, Plan, Step, folder_changes, secret_file
from keymint.workspace.session import Session
from keymint.workspace.stored_keys import AUTHORITY_KEYS, password, with_recorded_keys


def plan_renewal(session: Session, name: str) -> Plan:
    """Plan later dates for the certificate of an authority; its length, key and name stay.

    Only the profile changes: what rests on it must be planned afterwards.

    Raises:
        KeymintError: there is no such authority, its key is elsewhere, its key is being replaced, or its name has its
            RDNs in another order than the profile.
    """
    authority = authority_named(session, name)
    require_no_rollover(session, name)
    minted = plan_authorities(session)[1][name]
    _require_key(name, minted)
    pem = certificates.to_pem(minted.certificate)
    if not authority.issuance.adopted and authority_files.is_reordered(pem, authority.certificate):
        own = distinguished_names.to_text(minted.certificate.subject)
        message = f"the profile has the RDNs of {own!r} in another order, so its certificate is used as it is"
        help_ = f"write <subject_name>{own}</subject_name> for this authority, then renew it"
        raise KeymintError(message, where=authority.certificate.origin, help=help_, code="authority-reordered")
    issuance = replace(authority.issuance, renewed=periods.begin(session.now))
    if authority.issuance.adopted:
        issuance = replace(issuance, adopted=_adopted_again(session, authority, minted))
    plan = plan_authority_issuance(session, name, issuance, f"{name} renewed on {session.now:%Y-%m-%d}")
    after = authority_named(session.after(plan).session(), name).certificate
    if (after.validity, after.adopted) == (authority.certificate.validity, authority.certificate.adopted):
        return Plan((), session.state)  # it would not end later
    return plan


def _adopted_again(session: Session, authority: Authority, minted: MintedAuthority) -> bytes:
    """Return the successor of an imported certificate, or the certificate itself if it is from today."""
    certificate = minted.certificate
    where = session.workspace.origin(session.workspace.authority_certificate(authority.name))
    is_of_today = certificate.not_valid_after_utc >= _later_end(session, authority, certificate)
    if is_of_today and not any(foreign_authorities.defects(certificate, authority.name, where)):
        return certificates.to_pem(certificate)
    return issued_like(session, authority, certificate, minted.issuer.key)


def _later_end(session: Session, authority: Authority, certificate: x509.Certificate) -> datetime:
    """Return the end of an imported certificate that is issued again: it is as long as before."""
    begin = authority.issuance.renewed or certificate.not_valid_before_utc
    return periods.begin(session.now) + (certificate.not_valid_after_utc - begin)


def issued_like(session: Session, authority: Authority, certificate: x509.Certificate, key: keys.PrivateKey) -> bytes:
    """Return a certificate of an authority like an imported one, but with a later end, PEM.

    Args:
        session: the workspace and its profile.
        authority: the authority.
        certificate: the imported certificate.
        key: the private key that it certifies.

    Raises:
        KeymintError: the authority above it cannot sign here.
    """
    end = max(_later_end(session, authority, certificate), certificate.not_valid_after_utc)
    validity = Validity(certificate.not_valid_before_utc, end)
    where = session.workspace.origin(session.workspace.authority_certificate(authority.name))
    return foreign_authorities.issued_like(certificate, key, validity, issuer_of(session, authority), where)


def issuer_of(session: Session, authority: Authority) -> certificates.Issuer | None:
    """Return the authority above another one, as an issuer; None if the other one has a self-signed certificate."""
    above = authority.certificate.issuer
    return plan_authorities(session)[1][above].issuer if above else None


def _require_key(name: str, minted: MintedAuthority) -> None:
    """Require that an authority can sign here.

    Raises:
        KeymintError: its private key is elsewhere, or its password is not set.
    """
    try:
        _ = minted.issuer
    except KeymintError as error:
        elsewhere = (
            f"run this where the key is, then 'keymint authority export {name}' there and "
            f"'keymint authority import {name} FILE' here"
        )
        raise KeymintError.of(
            replace(each, help=elsewhere if each.code == "authority-key-missing" else each.help)
            for each in error.diagnostics
        ) from None


def require_no_rollover(session: Session, name: str) -> None:
    """Require that the key of an authority is not being replaced.

    Raises:
        KeymintError: it is.
    """
    rollover = authority_named(session, name).issuance.rollover
    if rollover is not None:
        raise KeymintError(
            f"the key of the authority {name!r} is being replaced (phase {rollover.phase})",
            help=f"'keymint authority replace {name}' says how to end that",
            code="rollover-under-way",
        )


def plan_import(session: Session, name: str, given: GivenAuthority) -> Plan:
    """Plan to use a certificate that somebody else issued, and perhaps its private key.

    Only profile, certificate and key change: what rests on them must be planned afterwards. Without a key, it stays
    elsewhere, or is here already.

    Raises:
        KeymintError: as :func:`cert_and_key`; or installed enclaves trust another key
            of this authority.
    """
    authority = authority_named(session, name)
    require_no_rollover(session, name)
    certificate, key = cert_and_key(session, authority, given)
    public = certificates.public_key(certificate, given.where)
    files = authority_files.read_files(session, authority)
    authority_files.require_known(files, public, given.where)
    changes: list[FolderChange] = []
    key_path, stored = session.workspace.authority_key(name), authority_files.stored_key(session, authority, name)
    present = stored[1].public_key() if stored else None
    if key and present != public:
        changes.append(secret_file(key_path, key))
    elif present is not None and present != public:
        # Nobody trusts the key that was minted: the enclaves, if there are any, trust the new one.
        changes.append(FolderChange(key_path.parent, removed=(key_path.name,), private=True))
    exposed = keys.fingerprint(public) if given.exposed else authority.issuance.exposed
    decided = AuthorityIssuance(adopted=certificates.to_pem(certificate), exposed=exposed)
    plan = plan_authority_issuance(session, name, decided, f"{name} imported from {given.where}")
    path = session.workspace.authority_certificate(name)
    changes += folder_changes(session.tree, path.parent, {path.name: decided.adopted})
    files_step = Step(STAGE, name, Action.UPDATED, tuple(changes), "certificate authority")
    fingerprint = keys.fingerprint(public)
    state = with_recorded_keys(session.state, AUTHORITY_KEYS, {name: fingerprint})
    return replace(plan, steps=(*plan.steps, *((files_step,) if changes else ())), state=state)


@dataclass(frozen=True, slots=True)
class GivenAuthority:
    """Files that the user names.

    Attributes:
        certificate: a file with a certificate.
        where: this file, for messages.
        key: a file with its private key, encrypted with the authority's password or not; empty if none is given.
        key_file: this file, for messages; None if none is given.
        exposed: others could read the private key.
    """

    certificate: bytes
    where: Origin
    key: bytes = field(default=b"", repr=False)
    key_file: Origin | None = None
    exposed: bool = False


def cert_and_key(session: Session, authority: Authority, given: GivenAuthority) -> tuple[x509.Certificate, bytes]:
    """Return the certificate, and the private key as it is to be stored: PEM, or empty if none is given.

    Args:
        session: the workspace and its profile.
        authority: the authority whose certificate it is to be.
        given: the files.

    Raises:
        KeymintError: the certificate is not that of an authority, or not issued by its issuer in the profile; the key
            is another one, or is to lie in a token.
    """
    certificate = foreign_authorities.require_authority(given.certificate, given.where)
    _require_issuer(session, authority.certificate.issuer, certificate, given.where)
    if not given.key:
        return certificate, b""
    spec = authority.certificate
    if spec.key.uri:
        raise only_in_token(authority, "import it with the token's own tool")
    secret = password(session, spec)
    private = keys.from_pem(given.key, secret, given.key_file)
    of, help_ = str(given.where), "name the files that belong together"
    authority_files.require_pair(private, certificate, given.key_file, of, help_)
    return certificate, keys.to_pem(private, secret)


def _require_issuer(session: Session, issuer: str, certificate: x509.Certificate, where: Origin) -> None:
    """Require that a certificate was issued by the authority above it in the profile, or by itself.

    Raises:
        KeymintError: it was not: enclaves need all authorities up to a self-signed one.
    """
    above = authority_files.stored_certificate(session, issuer) if issuer else certificate
    if not certificates.is_issued_by(certificate, above):
        expected = f"the authority {issuer!r}" if issuer else "itself"
        raise KeymintError(
            f"was issued by {distinguished_names.to_text(certificate.issuer)!r}, but the profile expects {expected}",
            where=where,
            help="add its issuer to authorities.xml and name it in <issuer_name>; then import the issuer first",
            code="authority-issuer-elsewhere",
        )


def plan_encryption(session: Session, name: str) -> Plan:
    """Plan to encrypt the private key of an authority; while it is replaced, both keys.

    Args:
        session: the workspace and its profile.
        name: the authority.

    Raises:
        KeymintError: there is no such authority, the profile does not ask for encryption, the key is elsewhere or
            damaged, or its password is not set or wrong.
    """
    authority = authority_named(session, name)
    spec, files = authority.certificate, authority_files.read_files(session, authority)
    if not spec.key.password_env:
        raise KeymintError(
            f"the profile does not ask for an encrypted key of the authority {name!r}",
            where=spec.origin,
            help="write BestAvailableEncryption and a <password_env>, there or in the defaults of authorities",
            code="encryption-unasked",
        )
    if files.key is None:
        raise authority_files.key_elsewhere(name, files.key_file, "encrypt it where it is")
    encrypted = []
    for file in filter(None, (name, authority_files.other(authority))):
        path, stored = session.workspace.authority_key(file), authority_files.stored_key(session, authority, file)
        if stored and not keys.is_encrypted(stored[0]):
            encrypted.append(secret_file(path, keys.to_pem(stored[1], password(session, spec))))
    if not encrypted:
        return Plan((Step(STAGE, name, Action.UNCHANGED),), session.state)
    message, where = "backups and copies of this file still hold the plain key", files.key_file
    help_ = f"delete them, or make a new key with 'keymint authority replace {name}'"
    copies = Diagnostic.warning("key-copies", message, where, help_)
    step = Step(STAGE, name, Action.UPDATED, tuple(encrypted), "private key encrypted")
    return Plan((step,), session.state, (copies,))
