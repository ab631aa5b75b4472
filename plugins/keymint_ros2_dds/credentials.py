# SPDX-License-Identifier: Apache-2.0
"""Checks of the credentials in an enclave: certificate, key and revocation list."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import datetime
from functools import lru_cache

from cryptography import x509

from comarmor.errors import Diagnostic
from keymint.errors import KeymintError
from keymint.pki import certificates, revocation_lists
from keymint.pki.identity_check import IdentityCheck
from keymint_ros2_dds.enclave_layout import CERTIFICATE, CRL


class CredentialCheck(IdentityCheck):
    """Checks of one enclave that ``keymint check`` and ``keymint prove`` share."""

    def _revocation_list(self, chain: bytes, help_: str) -> Iterator[Diagnostic]:
        """Check the revocation list, if there is one; vendors refuse participants with an invalid one."""
        pem = self._files.get(CRL)
        problem = "" if pem is None else revocation_problem(pem, self._files.get(CERTIFICATE, b""), chain)
        if problem:
            yield self._error("revocation-list", CRL, problem, help_)


@lru_cache(maxsize=4096)
def subject_of(pem: bytes) -> x509.Name:
    """Return the subject of the one certificate of a file; errors as :func:`keymint.pki.certificates.load`."""
    return certificates.load(pem).subject


def revocation_period(pem: bytes) -> tuple[datetime, datetime] | None:
    """Return the validity period of a revocation list, in UTC; None for bytes that are not a revocation list."""
    crl = revocation_lists.first(pem)
    return None if crl is None else revocation_lists.period(crl)


def revocation_problem(pem: bytes, identity: bytes, chain: bytes) -> str:
    """Return the defect of a revocation list for a certificate and its issuer's chain, or an empty text."""
    crl = revocation_lists.first(pem)
    if crl is None:
        return "is not a revocation list in PEM: vendors refuse the participant"
    try:
        serial = certificates.load(identity).serial_number
        authority = certificates.load_bundle(chain)[0]
    except KeymintError:
        return ""  # the certificate cannot be read, which is reported separately
    if not revocation_lists.is_by(crl, authority):
        return "is not a revocation list of the certificate's issuer: vendors refuse the participant"
    return "" if crl.get_revoked_certificate_by_serial_number(serial) is None else "revokes the certificate beside it"
