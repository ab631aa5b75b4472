# SPDX-License-Identifier: Apache-2.0
"""Certificate revocation lists (RFC 5280, 5): issued, read, and compared with the authority in force.

Transports do not start a node whose list has expired, is by another authority, or cannot be read. So no such list is
ever issued, and a file has exactly one.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from datetime import UTC, datetime, timedelta

from cryptography import x509
from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives import hashes

from comarmor.values import Data
from keymint.errors import KeymintError, Origin
from keymint.pki import certificates, der, extensions, periods
from keymint.pki.certificates import Issuer
from keymint.pki.distinguished_names import to_text

_FLAGS: Mapping[str, x509.ReasonFlags | None] = {
    "superseded": x509.ReasonFlags.superseded,
    "key-compromise": x509.ReasonFlags.key_compromise,
    "retired": x509.ReasonFlags.cessation_of_operation,
    "affiliation-changed": x509.ReasonFlags.affiliation_changed,
    "privilege-withdrawn": x509.ReasonFlags.privilege_withdrawn,
    "unspecified": None,  # RFC 5280, 5.3.1: should be absent instead
}
_LAST = datetime.max.replace(tzinfo=UTC) - timedelta(seconds=1)


class Revocation(Data):
    """A revoked serial number, when it was revoked (UTC), and why: a reason of RFC 5280, 5.3.1."""

    serial: int
    at: datetime
    reason: str


class RevocationList(Data):
    """A revocation list.

    Attributes:
        issuer: subject name of its authority, for messages.
        number: its number (RFC 5280, 5.2.3); 0 if it has none.
        this_update: when it was issued, UTC.
        next_update: its end, UTC; vendors refuse it afterwards.
        revocations: the revoked certificates.
    """

    issuer: str
    number: int
    this_update: datetime
    next_update: datetime
    revocations: tuple[Revocation, ...]


def require_signs_lists(authority: x509.Certificate, where: Origin) -> None:
    """Require that an authority may sign revocation lists (RFC 5280, 4.2.1.3).

    Raises:
        KeymintError: its keyUsage lacks cRLSign, so nobody accepts its lists.
    """
    if not extensions.may(authority, "cRLSign"):
        raise KeymintError(
            f"the certificate of {to_text(authority.subject)!r} cannot sign revocation lists: its keyUsage lacks "
            "cRLSign",
            where=where,
            help="add cRLSign to its keyUsage in authorities.xml and run 'keymint authority renew', which issues the "
            "certificate again for the same key; without it, revoking needs a new authority",
            code="authority-cannot-revoke",
        )


def issue(
    issuer: Issuer, revocations: Iterable[Revocation], number: int, now: datetime, end: datetime | None = None
) -> bytes:
    """Issue a revocation list, PEM.

    Args:
        issuer: the authority, which may sign lists; see :func:`require_signs_lists`.
        revocations: all that the authority ever revoked.
        number: higher than that of every earlier list.
        now: the clock, UTC. The list is valid from a day before, since clocks differ; a short one as
            :func:`keymint.pki.periods.back` has it.
        end: its nextUpdate, at most the end of the authority's certificate, which is the default.

    Raises:
        KeymintError: the authority's certificate expired, or begins after the end of the list.
    """
    authority = issuer.certificate
    first, latest = certificates.period(authority)
    last = min(end or _LAST, latest)
    back = min(periods.BACK, (last - now) / 9)  # a tenth of the whole
    begin = max(now.replace(microsecond=0) - back, first)
    if last <= max(now, begin):
        raise KeymintError(
            f"the certificate of {to_text(authority.subject)!r} is in force from {first:%Y-%m-%d} to "
            f"{latest:%Y-%m-%d}, so no revocation list of it would be in force now ({now:%Y-%m-%d})",
            help="compare the clock of this machine; 'keymint authority renew' issues the certificate again",
            code="authority-not-in-force",
        )
    builder = (
        x509.CertificateRevocationListBuilder()
        .issuer_name(authority.subject)
        .last_update(begin)
        .next_update(last)
        .add_extension(x509.CRLNumber(number), critical=False)
        .add_extension(extensions.authority_key_identifier(authority), critical=False)
    )
    for each in sorted(revocations, key=lambda each: (each.at, each.serial)):
        entry = x509.RevokedCertificateBuilder().serial_number(each.serial).revocation_date(each.at)
        if flag := _FLAGS[each.reason]:
            entry = entry.add_extension(x509.CRLReason(flag), critical=False)
        builder = builder.add_revoked_certificate(entry.build())
    return _pem(builder.sign(issuer.key, hashes.SHA256()))


def _pem(crl: x509.CertificateRevocationList) -> bytes:
    return der.pem(b"X509 CRL", der.der_of(crl))


def load(pem: bytes, where: Origin) -> RevocationList:
    """Return the revocation list of a file, unverified; see :func:`problem`.

    Raises:
        KeymintError: the file does not have exactly one list in canonical PEM.
    """
    try:
        crl = parse(pem)
        if _pem(crl) != pem:
            raise ValueError
        number = extensions.value(crl, x509.CRLNumber)
        return RevocationList(
            to_text(crl.issuer), number.crl_number if number else 0, *period(crl), tuple(map(_revocation, crl))
        )
    except certificates.UNREADABLE:
        raise KeymintError(
            "is not one revocation list in PEM",
            where=where,
            help="'keymint crl --refresh' issues it again",
            code="revocation-list-invalid",
        ) from None


def _revocation(entry: x509.RevokedCertificate) -> Revocation:
    given = extensions.value(entry, x509.CRLReason)
    reason = next((name for name, flag in _FLAGS.items() if given and given.reason is flag), "unspecified")
    return Revocation(entry.serial_number, entry.revocation_date_utc, reason)


def entry(crl: x509.CertificateRevocationList, serial: int) -> Revocation | None:
    """Return what a list says about a certificate; None if it is not revoked."""
    found = crl.get_revoked_certificate_by_serial_number(serial)
    return None if found is None else _revocation(found)


def first(pem: bytes) -> x509.CertificateRevocationList | None:
    """Return the first revocation list of a file, the only one that transports read; None if they can read none."""
    try:
        return parse(pem)
    except ValueError:
        return None


def parse(pem: bytes) -> x509.CertificateRevocationList:
    """Return the first revocation list of a file.

    Raises:
        ValueError: there is none, or it is damaged.
    """
    try:
        return x509.load_pem_x509_crl(pem)
    except x509.InvalidVersion as error:
        raise ValueError(str(error)) from None


def period(crl: x509.CertificateRevocationList) -> tuple[datetime, datetime]:
    """Return when a revocation list is in force, UTC; without a nextUpdate it does not end."""
    return crl.last_update_utc, crl.next_update_utc or _LAST


def period_in(pem: bytes) -> tuple[datetime, datetime] | None:
    """Return when the first revocation list of a file is in force, UTC; None if it has none that can be read."""
    crl = first(pem)
    return None if crl is None else period(crl)


def is_by(crl: x509.CertificateRevocationList, authority: x509.Certificate) -> bool:
    """Tell whether an authority issued a revocation list: it has its name, and the signature of its key."""
    try:
        return crl.issuer == authority.subject and crl.is_signature_valid(certificates.public_key(authority))
    except (ValueError, TypeError, UnsupportedAlgorithm, KeymintError):
        return False


def problem(pem: bytes, authority: x509.Certificate) -> str:
    """Return why nodes with this list and authority do not start, dates aside; empty if they do."""
    crl = first(pem)
    if crl is None:
        return "is not a revocation list in PEM"
    return "" if is_by(crl, authority) else "is not a revocation list of the certificate's issuer"
