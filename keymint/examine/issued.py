# SPDX-License-Identifier: Apache-2.0
"""Judge installed certificates: the register has each as it is, it is not revoked, and has the dates of its sources."""

from __future__ import annotations

from collections.abc import Iterator

from cryptography import x509

from comarmor.errors import Diagnostic
from keymint.authority.authority_files import issuers
from keymint.errors import KeymintError
from keymint.life.terms import shown
from keymint.life.workspace_register import complete_register, issuer_of, register_of
from keymint.pki import certificate_forms, certificates
from keymint.workspace.installed_enclaves import CERTIFICATE, installed_certificate, with_sources
from keymint.workspace.package_build_types import is_build_current
from keymint.workspace.session import Session


def issued_here(session: Session) -> Iterator[tuple[str, x509.Certificate, x509.Certificate]]:
    """Yield the packages with the certificate of their enclave and its issuer; others are reported with the chain."""
    authorities = [issuer for _, _, issuer in issuers(session)]
    for name in with_sources(session):
        certificate = installed_certificate(session, name)
        issuer = next((each for each in authorities if certificate and certificate.issuer == each.subject), None)
        if certificate and issuer:
            yield name, certificate, issuer


def registered(session: Session) -> Iterator[Diagnostic]:
    """Yield a finding for each installed certificate of our authorities that is not as it was issued.

    Without a register nothing is known of what was issued: a finding if something was revoked, unless private files are
    left out.

    Raises:
        KeymintError: the register or a package has defects.
    """
    if session.tree.read(session.workspace.register) is None:
        if not session.tree.is_left_out(session.workspace.register):
            try:
                complete_register(session)
            except KeymintError as error:
                yield from error.diagnostics
        return
    register = register_of(session)
    for name, certificate, issuer in issued_here(session):
        known = register.certificates.get((issuer_of(issuer), certificate.serial_number))
        package = session.package(name, built=is_build_current(session, name))
        where = session.workspace.origin(f"{session.enclave_folder(name)}/{CERTIFICATE}")
        issue = f"'keymint install {name}' issues another one"
        first, last = certificates.period(certificate)
        if known is None:
            message = f"is a certificate with the serial number {certificate.serial_number:x} that nobody registered"
            help_ = f"find out who issued it: the key of {package.identity.issuer!r} did; then {issue}"
            yield Diagnostic.error("certificate-unregistered", message, where, help_, package.subject)
        elif (known.name, known.key, known.not_before, known.not_after) != (
            name, certificates.fingerprint(certificate), first, last,
        ):  # fmt: skip
            message = f"differs from the certificate that was issued with the serial number {known.serial:x}"
            yield Diagnostic.error("certificate-unregistered", message, where, issue, package.subject)
        elif known.revoked is not None:
            message = f"was revoked on {shown(known.revoked)} ({known.reason})"
            help_ = f"remove the enclave; 'keymint renew --rekey {name}' makes a new key and certificate"
            yield Diagnostic.error("certificate-revoked", message, where, help_, package.subject)
        else:
            wanted = certificate_forms.cut(package.identity.validity, issuer)
            if (first, last) != (wanted.not_before, wanted.not_after):
                message = f"is in force from {shown(first)} to {shown(last)}, which is not what the sources ask for"
                yield Diagnostic.warning("certificate-drift", message, where, issue, package.subject)
