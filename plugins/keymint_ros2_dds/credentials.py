# SPDX-License-Identifier: Apache-2.0
"""Checks of the credentials in an enclave: certificate, key and revocation list."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from datetime import datetime
from functools import lru_cache

from cryptography import x509

from comarmor.errors import Diagnostic, Origin, Severity
from keymint.errors import KeymintError
from keymint.pki import certificates, keys, public_keys, revocation_lists
from keymint.pki.distinguished_names import to_text
from keymint_ros2_dds.enclave_layout import CERTIFICATE, CRL, KEY


class CredentialCheck:
    """Checks of one enclave that ``keymint check`` and ``keymint prove`` share.

    Args:
        files: the enclave's files by name.
        folder: its folder as the user would type it.
        restore: help for a file that ``keymint install`` restores.
        subject: the subject of the findings, if they name it.
    """

    def __init__(self, files: Mapping[str, bytes], folder: str, restore: str, subject: str = "") -> None:
        self._files = files
        self._folder = folder
        self._restore = restore
        self._subject = subject

    def _where(self, name: str) -> Origin:
        return Origin(f"{self._folder}/{name}")

    def _error(self, code: str, name: str, message: str, help_: str = "") -> Diagnostic:
        """Return an error about a file; by default ``keymint install`` fixes it."""
        return Diagnostic(code, Severity.ERROR, message, self._where(name), help_ or self._restore, self._subject)

    def _revocation_list(self, chain: bytes, help_: str) -> Iterator[Diagnostic]:
        """Check the revocation list, if there is one; vendors refuse participants with an invalid one."""
        pem = self._files.get(CRL)
        problem = "" if pem is None else revocation_problem(pem, self._files.get(CERTIFICATE, b""), chain)
        if problem:
            yield self._error("revocation-list", CRL, problem, help_)

    def _subject_name(self, certificate: x509.Certificate, expected: x509.Name) -> Iterator[Diagnostic]:
        if certificate.subject != expected:
            message = f"is for {to_text(certificate.subject)!r}, not {to_text(expected)!r}"
            yield self._error("certificate-subject", CERTIFICATE, message)

    def _key(self, certificate: x509.Certificate, public_key: bytes = b"") -> Iterator[Diagnostic]:
        """Check that the key, if the enclave has one, is that of its certificate.

        Args:
            certificate: the identity certificate.
            public_key: the key that it must be for (PEM), if the private key is elsewhere; empty if it may be for any.
        """
        if public_key and not public_keys.is_of(public_key, certificate):
            yield self._error("key-mismatch", CERTIFICATE, "is for another public key than the package has")
        pem = self._files.get(KEY)
        if pem is None:
            return
        try:
            matches = keys.matches(keys.public_of(pem, None, self._where(KEY)), certificate)
        except KeymintError as error:
            yield from error.diagnostics
            return
        if not matches:
            yield self._error("key-mismatch", KEY, "is not the key of the certificate beside it")


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
