# SPDX-License-Identifier: Apache-2.0
"""Changes of one authority: issued again with later dates, taken from outside, or its stored key encrypted.

Also whom an authority serves, and what the implementations of the transports accept while it changes.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Sequence
from datetime import datetime

from cryptography import x509

from comarmor.text import did_you_mean
from comarmor.values import Data, field, replace
from keymint.api import Authority, AuthorityIssuance, Implementation, Validity
from keymint.authority import authorities, authority_files, examine
from keymint.authority.authorities import STAGE, authority_named, plan_authorities, plan_authority_issuance
from keymint.authority.authority_files import with_issuers
from keymint.errors import Diagnostic, ExitCode, KeymintError, Origin
from keymint.pki import certificates, distinguished_names, foreign_authorities, keys, periods
from keymint.store.changes import Action, FolderChange, Plan, Step, folder_changes, secret_file
from keymint.workspace.package_build_types import build_types_of, is_build_current
from keymint.workspace.session import Session, once_of_sources
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
    try:
        key = minted.issuer.key
    except KeymintError as error:
        elsewhere = (
            f"run this where the key is, then 'keymint authority export {name}' there and "
            f"'keymint authority import {name} FILE' here"
        )
        raise KeymintError.of(
            replace(each, help=elsewhere if each.code == "authority-key-missing" else each.help)
            for each in error.diagnostics
        ) from None
    pem = certificates.to_pem(minted.certificate)
    if not authority.issuance.adopted and authority_files.is_reordered(pem, authority.certificate):
        own = distinguished_names.to_text(minted.certificate.subject)
        message = f"the profile has the RDNs of {own!r} in another order, so its certificate is used as it is"
        help_ = f"write <subject_name>{own}</subject_name> for this authority, then renew it"
        raise KeymintError(message, where=authority.certificate.origin, help=help_, code="authority-reordered")
    issuance = replace(authority.issuance, renewed=periods.begin(session.now))
    if authority.issuance.adopted:
        where = session.workspace.origin(session.workspace.authority_certificate(name))
        is_of_today = minted.certificate.not_valid_after_utc >= _later_end(session, authority, minted.certificate)
        if not is_of_today or any(foreign_authorities.defects(minted.certificate, name, where)):
            pem = issued_like(session, authority, minted.certificate, key)
        issuance = replace(issuance, adopted=pem)
    plan = plan_authority_issuance(session, name, issuance, f"{name} renewed on {session.now:%Y-%m-%d}")
    after = authority_named(session.after(plan).session(), name).certificate
    if (after.validity, after.adopted) == (authority.certificate.validity, authority.certificate.adopted):
        return Plan((), session.state)  # it would not end later
    return plan


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


def require_no_rollover(session: Session, name: str) -> None:
    """Require that the key of an authority is not being replaced.

    Raises:
        KeymintError: it is.
    """
    rollover = authority_named(session, name).issuance.rollover
    if rollover is not None:
        message = f"the key of the authority {name!r} is being replaced (phase {rollover.phase})"
        help_ = f"'keymint authority replace {name}' says how to end that"
        raise KeymintError(message, help=help_, code="rollover-under-way")


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
    examine.require_known(files, public, given.where)
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


class GivenAuthority(Data):
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
        raise authorities.only_in_token(authority, "import it with the token's own tool")
    secret = password(session, spec)
    private = keys.from_pem(given.key, secret, given.key_file)
    of, help_ = str(given.where), "name the files that belong together"
    examine.require_pair(private, certificate, given.key_file, of, help_)
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
        message = f"the profile does not ask for an encrypted key of the authority {name!r}"
        help_ = "write BestAvailableEncryption and a <password_env>, there or in the defaults of authorities"
        raise KeymintError(message, where=spec.origin, help=help_, code="encryption-unasked")
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


class Use(Data, order=True):
    """What an authority does for some packages.

    Attributes:
        build_type: the build type whose enclaves rest on it.
        role: what it does, as the build type calls it.
        signs: its private key signs documents of these packages.
        packages: number of these packages.
    """

    build_type: str
    role: str
    signs: bool
    packages: int


@once_of_sources
def uses(session: Session) -> dict[str, tuple[Use, ...]]:
    """Return what each authority does; an authority above others is used as they are.

    Raises:
        KeymintError: a package has defects.
    """
    issuers = {each.name: each.certificate.issuer for each in session.profile.authorities}
    counts: Counter[tuple[str, str, str, bool]] = Counter()
    for package in (session.package(name, built=is_build_current(session, name)) for name in session.packages()):
        for build_type, plugin in build_types_of(session, package).items():
            found: set[tuple[str, str, str, bool]] = set()
            for role in plugin.authorities(package):
                for name in with_issuers(role.name, issuers):
                    found.add((name, build_type, role.role, role.signs and name == role.name))
            counts.update(found)
    every = [(name, Use(build_type, role, signs, number)) for (name, build_type, role, signs), number in counts.items()]
    return {authority: tuple(sorted(use for name, use in every if name == authority)) for authority in issuers}


def implementations(session: Session, chosen: Collection[str] = ()) -> dict[str, Sequence[Implementation]]:
    """Return the implementations that a fleet may have, by build type; none for a transport that was not measured.

    Args:
        session: the workspace and its profile.
        chosen: names of the implementations that the fleet has; of a transport without a chosen one, all.

    Raises:
        KeymintError: no transport has an implementation of this name; exit code 2.
    """
    build_types = sorted({use.build_type for of_authority in uses(session).values() for use in of_authority})
    build_types = build_types or sorted(session.profile.build_types)
    where = session.profile_marker()
    known = {name: session.plugins.build_type(name, where).implementations() for name in build_types}
    names = {each.name for of_type in known.values() for each in of_type}
    for name in chosen:
        if name not in names:
            message = f"no transport of this workspace has an implementation {name!r}"
            help_ = did_you_mean(name, names, f"known are {', '.join(sorted(names)) or 'none'}")
            raise KeymintError(message, help=help_, code="implementation-unknown", exit_code=ExitCode.USAGE)
    return {name: tuple(each for each in of_type if each.name in chosen) or of_type for name, of_type in known.items()}


def refusing_implementations(session: Session, name: str, chosen: Collection[str], what: str) -> tuple[str, ...]:
    """Return the implementations that do not accept a change of an authority in a role that it has.

    Args:
        session: the workspace and its profile.
        name: the authority.
        chosen: names of the implementations that the fleet has; see :func:`implementations`.
        what: ``bundles`` or ``reissues``; see :class:`keymint.api.Implementation`.

    Returns:
        Their titles, or the name of a build type that was not measured; empty if all accept it.
    """
    known = implementations(session, chosen)
    titles: dict[str, None] = {}
    for use in uses(session)[name]:
        for each in known[use.build_type]:
            if use.role not in (each.bundles if what == "bundles" else each.reissues):
                titles[each.title] = None
        if not known[use.build_type]:
            titles[use.build_type] = None
    return tuple(titles)
