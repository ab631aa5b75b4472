# SPDX-License-Identifier: Apache-2.0
"""Checks of the certificate, the key and the authorities in an enclave, as Zenoh's TLS needs them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from ipaddress import ip_address

from cryptography import x509
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from comarmor.errors import Diagnostic, Origin, Severity
from keymint.api import Inspection
from keymint.errors import KeymintError
from keymint.pki import certificates, certification_path, distinguished_names, extensions, keys, public_keys
from keymint_ros2_zenoh.authority_roles import IDENTITY
from keymint_ros2_zenoh.enclave_layout import CERTIFICATE, IDENTITY_CA, KEY
from keymint_ros2_zenoh.settings import is_address, is_router, settings_of


def first_common_name(pem: bytes) -> str:
    """Return the first common name of a certificate, by which routers know a subject; empty if there is none.

    Raises:
        KeymintError: no certificate.
    """
    for part in certificates.load(pem).subject:
        if part.oid == NameOID.COMMON_NAME:
            return str(part.value)
    return ""


def check_credentials(inspection: Inspection) -> Iterator[Diagnostic]:
    """Yield findings on the certificate, the key and the authorities of an enclave."""
    package, files = inspection.package, inspection.files
    restore = f"'keymint install {package.name}' writes it again"

    def error(code: str, name: str, message: str, help_: str = restore) -> Diagnostic:
        return Diagnostic(code, Severity.ERROR, message, _where(inspection, name), help_, package.subject)

    if IDENTITY_CA in files and files[IDENTITY_CA] != inspection.chains[IDENTITY]:
        yield error("authority-differs", IDENTITY_CA, "is not the certificate of the workspace's authority")
    pem = files.get(CERTIFICATE)
    if pem is None:
        return
    where = _where(inspection, CERTIFICATE)
    chain = certification_path.verify_chain(pem, inspection.chains[IDENTITY], inspection.now, where)
    yield from (replace(each, where=each.where or where, subject=package.subject) for each in chain)
    try:
        certificate = certificates.load(pem, where)
    except KeymintError:
        return  # verify_chain reports it
    expected = distinguished_names.parse(package.identity.subject_name)
    if certificate.subject != expected:
        shown = distinguished_names.to_text
        yield error(
            "certificate-subject", CERTIFICATE, f"is for {shown(certificate.subject)!r}, not {shown(expected)!r}"
        )
    if not any(each.code in {"certificate-expired", "certificate-not-yet-valid"} for each in chain):
        yield from _expires(certificate, inspection)
    yield from _usage(certificate, inspection)
    yield from _key(certificate, inspection)


def _where(inspection: Inspection, name: str) -> Origin:
    return Origin(f"{inspection.folder}/{name}")


def _expires(certificate: x509.Certificate, inspection: Inspection) -> Iterator[Diagnostic]:
    end: datetime = certificate.not_valid_after_utc
    if inspection.now + timedelta(days=inspection.within_days) >= end:
        yield Diagnostic(
            "certificate-expires", Severity.WARNING,
            f"the certificate expires on {end.astimezone(UTC):%Y-%m-%d %H:%M} UTC",
            _where(inspection, CERTIFICATE),
            f"'keymint renew {inspection.package.name}' issues it again, with later dates", inspection.package.subject,
        )  # fmt: skip


def _usage(certificate: x509.Certificate, inspection: Inspection) -> Iterator[Diagnostic]:
    """Yield what a certificate lacks, or has too much: a router is a server of its host, all others are clients."""
    package = inspection.package
    is_server = is_router(package)
    where, install = _where(inspection, CERTIFICATE), f"'keymint install {package.name}' writes it again"
    usage = extensions.value(certificate, x509.ExtendedKeyUsage)
    server, client = ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH
    needed = server if is_server else client
    if usage is not None and needed not in usage and ExtendedKeyUsageOID.ANY_EXTENDED_KEY_USAGE not in usage:
        message = f"its extendedKeyUsage lacks {'serverAuth' if is_server else 'clientAuth'}, and Zenoh refuses it"
        yield Diagnostic("zenoh-key-usage", Severity.ERROR, message, where, install, package.subject)
    if not is_server and usage is not None and server in usage:
        message = "is also for servers: its holder could pretend to be a router where names are not checked"
        yield Diagnostic("zenoh-key-usage", Severity.WARNING, message, where, install, package.subject)
    host = settings_of(package).router.host
    if is_server and not _has_host(certificate, host):
        message = f"its subjectAltName lacks the router's host {host!r}, so that no session connects to it"
        yield Diagnostic("zenoh-host-name", Severity.ERROR, message, where, install, package.subject)


def _has_host(certificate: x509.Certificate, host: str) -> bool:
    names = extensions.value(certificate, x509.SubjectAlternativeName)
    if names is None:
        return False
    if is_address(host):
        return ip_address(host) in names.get_values_for_type(x509.IPAddress)
    return host.lower() in {name.lower() for name in names.get_values_for_type(x509.DNSName)}


def _key(certificate: x509.Certificate, inspection: Inspection) -> Iterator[Diagnostic]:
    pem, subject = inspection.files.get(KEY), inspection.package.subject
    public_key, restore = inspection.package.issuance.public_key, f"'keymint install {inspection.package.name}'"
    if public_key and not public_keys.is_of(public_key, certificate):
        message, where = "is for another public key than the package has", _where(inspection, CERTIFICATE)
        yield Diagnostic("key-mismatch", Severity.ERROR, message, where, f"{restore} writes it again", subject)
    if pem is None or inspection.package.identity.key.password_env:
        return
    where = _where(inspection, KEY)
    try:
        matches = keys.matches(keys.from_pem(pem, None, where), certificate)
    except KeymintError as error:
        yield from (replace(each, subject=subject) for each in error.diagnostics)
        return
    if not matches:
        yield Diagnostic(
            "key-mismatch", Severity.ERROR, "is not the key of the certificate beside it", where,
            f"{restore} writes it again", subject,
        )  # fmt: skip
