# SPDX-License-Identifier: Apache-2.0
"""Decide by the models of vendors whom a participant authenticates: itself when it is created, and its peers.

A participant reads its trusted authorities and its revocation list once, when it is created. Both vendors then require
for each certificate, its own first: a trusted issuer; the present within its period; and, if there is any list, one of
the issuer that is in force and does not name the certificate. ``tests/real/test_keystore_life.py`` measures it.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import datetime
from functools import lru_cache

from cryptography import x509

from comarmor.errors import Origin
from comarmor.regex import lazy_regex
from comarmor.values import dataclass
from keymint.api import Enclave
from keymint.api.transports import installed_file
from keymint.pki import certificates, revocation_lists
from keymint_ros2_dds.decision.semantics import Semantics
from keymint_ros2_dds.enclave_layout import CA, CERTIFICATE, CRL, IDENTITY_CA, KEY, KEY_URI, reads_revocations

_LIST = lazy_regex(rb"-----BEGIN X509 CRL-----.*?-----END X509 CRL-----", re.DOTALL)


@dataclass(frozen=True, slots=True)
class Authentication:
    """What the participant of an enclave authenticates with.

    Attributes:
        certificate: its own.
        authorities: the certificates in the file of the identity authority, in the file's order.
        listed: its revocation list, or None.
        unread: it has a file for that, which is no revocation list.
        among: the revocation lists in the file of the identity authority.
        in_token: its private key lies in a token, and in no file.
        now: the clock, UTC.
    """

    certificate: x509.Certificate
    authorities: tuple[x509.Certificate, ...]
    listed: x509.CertificateRevocationList | None
    unread: bool
    among: tuple[x509.CertificateRevocationList, ...]
    in_token: bool
    now: datetime

    def refusal(self, semantics: Semantics) -> str:
        """Return why the participant is not created, or an empty text."""
        if self.in_token and not semantics.keys_in_tokens:
            return f"{KEY} is missing, and {KEY_URI} is not read"
        return self.refuses(self.certificate, semantics)

    def refuses(self, certificate: x509.Certificate, semantics: Semantics) -> str:
        """Return why a certificate is refused, in a handshake or at creation; or an empty text."""
        trusted = self.authorities[:1] if semantics.one_authority else self.authorities
        issuer = next((each for each in trusted if _is_issued_by(certificate, each)), None)
        if issuer is None:
            return f"{CERTIFICATE} is by no authority that is trusted"
        period = certificates.period(certificate)
        lists = (self.listed, *(self.among if semantics.lists_among_authorities else ()))
        return (
            _outside(f"the certificate in {CERTIFICATE}", *period, self.now)
            or (f"{CRL} is not a revocation list" if self.unread else "")
            or _revoked(certificate, issuer, [each for each in lists if each is not None], self.now)
        )


@lru_cache(maxsize=4096)
def _is_issued_by(certificate: x509.Certificate, authority: x509.Certificate) -> bool:
    """Return whether an authority issued a certificate; models of all vendors ask it about each."""
    return certificates.is_issued_by(certificate, authority)


def _revoked(
    certificate: x509.Certificate,
    issuer: x509.Certificate,
    lists: Sequence[x509.CertificateRevocationList],
    now: datetime,
) -> str:
    if not lists:
        return ""
    found = next((each for each in lists if revocation_lists.is_by(each, issuer)), None)
    if found is None:
        return f"the revocation list in {CRL} is by another authority"
    if problem := _outside(f"the revocation list in {CRL}", *revocation_lists.period(found), now):
        return problem
    revoked = found.get_revoked_certificate_by_serial_number(certificate.serial_number)
    return "" if revoked is None else f"{CRL} revokes the certificate"


def _outside(what: str, begin: datetime, end: datetime, now: datetime) -> str:
    if now > end:
        return f"{what} has expired"
    return f"{what} is not yet valid" if now < begin else ""


def load(enclave: Enclave, now: datetime) -> Authentication:
    """Read what the participant of an enclave authenticates with.

    Args:
        enclave: the enclave.
        now: the clock, UTC.

    Raises:
        KeymintError: a file cannot be read, or is no certificate.
    """
    folder = enclave.folder
    trusted = IDENTITY_CA if (folder / IDENTITY_CA).exists() else CA  # the layout of Ardent has one file for both
    bundle = installed_file(folder / trusted)
    reads = reads_revocations(enclave.distro) and (folder / CRL).exists()
    listed = revocation_lists.first(installed_file(folder / CRL)) if reads else None
    return Authentication(
        certificates.load(installed_file(folder / CERTIFICATE), Origin(CERTIFICATE)),
        certificates.load_bundle(bundle, Origin(trusted)),
        listed,
        reads and listed is None,
        tuple(each for each in map(revocation_lists.first, _LIST.findall(bundle)) if each is not None),
        (folder / KEY_URI).exists() and not (folder / KEY).exists(),
        now,
    )
