"""The revocation list that an enclave may hold (``crl.pem``): vendors let nobody in who has a wrong one."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

from cryptography import x509
from cryptography.exceptions import UnsupportedAlgorithm

from keymint.errors import KeymintError
from keymint.pki import certificates

_LAST = datetime.max.replace(tzinfo=UTC) - timedelta(seconds=1)


def period(pem: bytes) -> tuple[datetime, datetime] | None:
    """Return when a revocation list holds, in UTC; None for bytes that are none."""
    try:
        found = x509.load_pem_x509_crl(pem)
    except ValueError:
        return None
    return found.last_update_utc, found.next_update_utc or _LAST


def problem(pem: bytes, identity: bytes, chain: bytes) -> str:
    """Return what is wrong with a revocation list for a certificate and the authority that issued it, or nothing."""
    try:
        found = x509.load_pem_x509_crl(pem)
        revoked = found.get_revoked_certificate_by_serial_number(certificates.load(identity).serial_number)
        authority = certificates.load_bundle(chain)[0]
        public = certificates.public_key(authority)
        if found.issuer != authority.subject or not found.is_signature_valid(public):
            return "is not a revocation list of the authority that issued the certificate: no participant is let in"
    except (ValueError, TypeError, UnsupportedAlgorithm):
        return "is not a revocation list in PEM: vendors refuse the participant"
    except KeymintError:
        return ""  # a certificate that cannot be read is a finding of its own
    return "" if revoked is None else "revokes the certificate beside it"
