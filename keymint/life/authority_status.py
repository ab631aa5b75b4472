# SPDX-License-Identifier: Apache-2.0
"""The authorities of a workspace as they are: ``keymint authority show``."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import datetime

from cryptography import x509

from comarmor.values import dataclass
from keymint.api import Authority
from keymint.authority import authority_files
from keymint.authority.authority_uses import Use, uses
from keymint.life.renewal_schedule import authority_renewals, installed_terms
from keymint.life.revocation_lists_in_force import list_of
from keymint.life.terms import DEFAULT
from keymint.pki import certificates, distinguished_names, extensions, keys
from keymint.pki.revocation_lists import RevocationList
from keymint.workspace.session import Session


@dataclass(frozen=True, slots=True)
class AuthorityStatus:
    """An authority as it is.

    Attributes:
        authority: the authority as the profile specifies it.
        certificate: its certificate as data, or None if it is missing or damaged.
        key_place: where its private key is: ``here``, ``elsewhere`` or ``token``.
        uses: what it does.
        other: the other certificate while its key is replaced, or None.
        revocations: its revocation list, or None if it never revoked anything.
    """

    authority: Authority
    certificate: CertificateStatus | None
    key_place: str
    uses: tuple[Use, ...]
    other: CertificateStatus | None
    revocations: RevocationList | None


@dataclass(frozen=True, slots=True)
class CertificateStatus:
    """A certificate of an authority.

    Attributes:
        subject: its subject name (RFC 4514).
        serial: its serial number, hexadecimal.
        key: kind of its key, e.g. ``EC SECP256R1`` or ``RSA 2048``.
        fingerprint: SHA-256 of the public key, hexadecimal.
        not_before: begin of its validity, UTC.
        not_after: end of its validity, UTC.
        renew_after: when it begins to shorten what it signs, as 'keymint renew' reports it; when two thirds of its
            validity are over if it signed nothing that is installed; UTC.
        key_usage: its key usages (RFC 5280, 4.2.1.3), or None if it has no such extension and may do everything.
        subject_key_identifier: in hexadecimal; None if it has none.
    """

    subject: str
    serial: str
    key: str
    fingerprint: str
    not_before: datetime
    not_after: datetime
    renew_after: datetime
    key_usage: tuple[str, ...] | None
    subject_key_identifier: str | None


def statuses(session: Session) -> Iterator[AuthorityStatus]:
    """Yield the authorities in the order of the profile.

    Raises:
        KeymintError: a package has defects, or a revocation list is damaged.
    """
    used = uses(session)
    due = authority_renewals(session, installed_terms(session, session.packages()))
    for authority in session.profile.authorities:
        files = authority_files.read_files(session, authority)
        rollover = authority.issuance.rollover
        yield AuthorityStatus(
            authority=authority,
            certificate=status_of(files.certificate, due.get(authority.name)) if files.certificate else None,
            key_place="token" if authority.certificate.key.uri else "here" if files.key is not None else "elsewhere",
            uses=used[authority.name],
            other=status_of(certificates.load(rollover.certificate)) if rollover else None,
            revocations=list_of(session, authority.name),
        )


def status_of(certificate: x509.Certificate, due: datetime | None = None) -> CertificateStatus:
    """Return a certificate of an authority as data.

    Args:
        certificate: the certificate.
        due: when it begins to shorten what it signs, UTC; None if that is not known.
    """
    public = certificates.public_key(certificate)
    kind = keys.kind_of(public)
    first, last = certificates.period(certificate)
    identifier = extensions.value(certificate, x509.SubjectKeyIdentifier)
    return CertificateStatus(
        subject=distinguished_names.to_text(certificate.subject),
        serial=f"{certificate.serial_number:x}",
        key=f"RSA {kind.size}" if kind.algorithm == "rsa" else f"EC {kind.curve}",
        fingerprint=keys.fingerprint(public),
        not_before=first,
        not_after=last,
        renew_after=due or DEFAULT.moment(first, last),
        key_usage=extensions.usages(certificate),
        subject_key_identifier=identifier.digest.hex() if identifier else None,
    )
