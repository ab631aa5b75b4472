"""Checks the revocation list of an enclave (``crl.pem``); vendors refuse participants with an invalid one."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

from cryptography import x509
from cryptography.exceptions import UnsupportedAlgorithm

from keymint.errors import KeymintError
from keymint.pki import certificates

_LAST = datetime.max.replace(tzinfo=UTC) - timedelta(seconds=1)


def period(pem: bytes) -> tuple[datetime, datetime] | None:
    """Return the validity period of a revocation list, in UTC; None for bytes that are not a revocation list."""
    try:
        crl = x509.load_pem_x509_crl(pem)
    except ValueError:
        return None
    return crl.last_update_utc, crl.next_update_utc or _LAST


def problem(pem: bytes, identity: bytes, chain: bytes) -> str:
    """Return the defect of a revocation list for a certificate and its issuer's chain, or an empty text."""
    try:
        crl = x509.load_pem_x509_crl(pem)
        revoked = crl.get_revoked_certificate_by_serial_number(certificates.load(identity).serial_number)
        authority = certificates.load_bundle(chain)[0]
        public = certificates.public_key(authority)
        if crl.issuer != authority.subject or not crl.is_signature_valid(public):
            return "is not a revocation list of the certificate's issuer: vendors refuse the participant"
    except (ValueError, TypeError, UnsupportedAlgorithm):
        return "is not a revocation list in PEM: vendors refuse the participant"
    except KeymintError:
        return ""  # the certificate cannot be read, which is reported separately
    return "" if revoked is None else "revokes the certificate beside it"
