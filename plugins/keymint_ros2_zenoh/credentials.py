# SPDX-License-Identifier: Apache-2.0
"""Checks of the certificate, the key and the authorities in an enclave, as Zenoh's TLS needs them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime, timedelta

from cryptography import x509
from cryptography.x509.oid import ExtendedKeyUsageOID

from comarmor.errors import Diagnostic, Severity
from keymint.api import Inspection
from keymint.errors import KeymintError
from keymint.pki import certificates, extensions
from keymint.pki.identity_check import IdentityCheck
from keymint_ros2_zenoh.decision.admission import common_name, lacking_usage, names_host
from keymint_ros2_zenoh.enclave_layout import CERTIFICATE
from keymint_ros2_zenoh.settings import is_router, settings_of


def first_common_name(pem: bytes) -> str:
    """Return the first common name of a certificate, by which routers know a subject; empty if there is none.

    Raises:
        KeymintError: no certificate.
    """
    return common_name(certificates.load(pem))


def check_credentials(inspection: Inspection) -> Iterator[Diagnostic]:
    """Yield findings on the certificate, the key and the authorities of an enclave."""
    return _Credentials(inspection).findings()


class _Credentials(IdentityCheck):
    """One enclave under inspection."""

    def __init__(self, inspection: Inspection) -> None:
        package = inspection.package
        restore = f"'keymint install {package.name}' writes it again"
        super().__init__(inspection.files, inspection.folder, restore, package.subject)
        self._inspection = inspection

    def findings(self) -> Iterator[Diagnostic]:
        try:
            certificate = certificates.load(self._files.get(CERTIFICATE, b""))
        except KeymintError:
            return  # reported with the chain
        yield from self._dates(*certificates.period(certificate))
        yield from self._usage(certificate)

    def _dates(self, begin: datetime, end: datetime) -> Iterator[Diagnostic]:
        """Yield why the certificate is not in force, or that it ends soon; both ends of its period count."""
        now, within = self._inspection.now, timedelta(days=self._inspection.within_days)
        help_ = f"'keymint renew {self._inspection.package.name}' issues it again, with later dates"
        if now > end:
            yield self._error("certificate-expired", CERTIFICATE, f"the certificate expired on {_shown(end)}", help_)
        elif now < begin:
            message = f"the certificate is not valid before {_shown(begin)}"
            yield self._error("certificate-not-yet-valid", CERTIFICATE, message, "compare the clock of this machine")
        elif end <= now + within:
            found = self._error("certificate-expires", CERTIFICATE, f"the certificate expires on {_shown(end)}", help_)
            yield replace(found, severity=Severity.WARNING)

    def _usage(self, certificate: x509.Certificate) -> Iterator[Diagnostic]:
        """Yield what a certificate lacks, or has too much: a router is a server of its host, all others are clients."""
        package = self._inspection.package
        is_server = is_router(package)
        usage = extensions.value(certificate, x509.ExtendedKeyUsage)
        if lacking := lacking_usage(certificate, server=is_server):
            message = f"its extendedKeyUsage lacks {lacking}, and Zenoh refuses it"
            yield self._error("zenoh-key-usage", CERTIFICATE, message)
        if not is_server and usage is not None and ExtendedKeyUsageOID.SERVER_AUTH in usage:
            message = "is also for servers: its holder could pretend to be a router where names are not checked"
            yield replace(self._error("zenoh-key-usage", CERTIFICATE, message), severity=Severity.WARNING)
        host = settings_of(package).router.host
        if is_server and not names_host(certificate, host):
            message = f"its subjectAltName lacks the router's host {host!r}, so that no session connects to it"
            yield self._error("zenoh-host-name", CERTIFICATE, message)


def _shown(moment: datetime) -> str:
    return f"{moment.astimezone(UTC):%Y-%m-%d %H:%M} UTC"
