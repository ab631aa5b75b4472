# SPDX-License-Identifier: Apache-2.0
"""Certification paths: from a certificate to a self-signed authority (RFC 5280, section 6).

``cryptography.x509.verification`` is for the web: it requires a subjectAltName. This module checks each link: name
chaining, signature, basicConstraints, path length, keyUsage, validity and unknown critical extensions.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from datetime import datetime
from functools import lru_cache

from cryptography import x509

from comarmor.errors import Diagnostic, Origin
from keymint.errors import KeymintError
from keymint.pki import certificates, distinguished_names, extensions

_UNDERSTOOD = (
    x509.BasicConstraints,
    x509.KeyUsage,
    x509.ExtendedKeyUsage,
    x509.SubjectAlternativeName,
    x509.CertificatePolicies,
)
"""Extensions that may be critical: they are checked here, or do not restrict what a keystore needs."""
_MAX_PATH = 16
"""Maximum certificates of a path; transports accept one authority, or a few."""


def verify_chain(
    certificate_pem: bytes, ca_pem_bundle: bytes, at: datetime | None, where: Origin | None = None
) -> list[Diagnostic]:
    """Verify a certificate against the trusted authorities, and return the findings.

    Args:
        certificate_pem: the certificate.
        ca_pem_bundle: authorities in any order: the issuer, and the others up to its self-signed root.
        at: the time at which every certificate of the path must be valid (aware); None: time does not matter.
        where: the certificate's file, for messages.

    Returns:
        Findings, none if the path is valid, with the codes ``certificate-invalid``, ``chain-incomplete``,
        ``chain-signature``, ``chain-not-authority``, ``chain-path-length``, ``chain-key-usage``,
        ``chain-critical-extension``, ``certificate-expired`` and ``certificate-not-yet-valid``.
    """
    path: list[x509.Certificate] = []
    problems: list[_Problem] = []
    unread: Sequence[Diagnostic] = ()
    try:
        path.append(certificates.load(certificate_pem, where))
        path, problem = _path(path[0], certificates.load_bundle(ca_pem_bundle, where))
        problems += [problem] if problem else []
    except KeymintError as error:
        unread = error.diagnostics  # the certificate, or its authorities: then it is checked alone
    for depth, link in enumerate(path):
        problems += [] if at is None else _time(link, at)
        problems += [*_critical(link), *(_authority(link, path[1:depth]) if depth else ())]
    return [*unread, *(Diagnostic.error(code, message, where, help_) for code, message, help_ in problems)]


_Problem = tuple[str, str, str]
"""Code, message and help of a finding."""


def _path(
    certificate: x509.Certificate, bundle: Sequence[x509.Certificate]
) -> tuple[list[x509.Certificate], _Problem | None]:
    """Return the path from a certificate upwards, and why it does not end at a self-signed one, if it does not."""
    path = [certificate]
    while len(path) <= _MAX_PATH:
        last = path[-1]
        # A workspace has few authorities, whose signatures are verified once.
        is_issued_by = certificates.is_issued_by if last is certificate else _is_issued_by
        if last.subject == last.issuer and (last in bundle or len(path) > 1):
            return path, None if is_issued_by(last, last) else _signature(last)
        named = [each for each in bundle if each.subject == last.issuer and each not in path]
        issuer = next((each for each in named if is_issued_by(last, each)), None)
        if issuer is None:
            if named:
                return path, _signature(last)
            break
        path.append(issuer)
    return path, (
        "chain-incomplete",
        f"the issuer {_shown(path[-1].issuer)} of {_shown(path[-1].subject)} is not among the authorities",
        "install it again, or add the missing authority",
    )


_is_issued_by = lru_cache(maxsize=64)(certificates.is_issued_by)


def _signature(certificate: x509.Certificate) -> _Problem:
    return (
        "chain-signature",
        f"{_shown(certificate.subject)} is not signed by the key of its issuer {_shown(certificate.issuer)}",
        "the certificate was altered, or the authority's key was replaced: install again",
    )


def _time(certificate: x509.Certificate, at: datetime) -> Iterator[_Problem]:
    begin, end = certificates.period(certificate)
    if at > end:
        yield (
            "certificate-expired",
            f"the certificate of {_shown(certificate.subject)} expired on {end:%Y-%m-%dT%H:%M:%SZ}",
            "'keymint renew' issues it again with later dates; that of an authority: 'keymint authority renew'",
        )
    elif at < begin:
        yield (
            "certificate-not-yet-valid",
            f"the certificate of {_shown(certificate.subject)} begins {begin:%Y-%m-%dT%H:%M:%SZ}",
            "compare the clock of this machine, or give it an earlier start",
        )


def _critical(certificate: x509.Certificate) -> Iterator[_Problem]:
    for extension in certificate.extensions:
        if extension.critical and not isinstance(extension.value, _UNDERSTOOD):
            yield (
                "chain-critical-extension",
                f"{_shown(certificate.subject)} has an unknown critical extension, {extension.oid.dotted_string}",
                "make it not critical",
            )


def _authority(certificate: x509.Certificate, below: Sequence[x509.Certificate]) -> Iterator[_Problem]:
    """Check an authority of a path; ``below`` are the authorities between it and the end (RFC 5280, 6.1.4)."""
    constraints = extensions.value(certificate, x509.BasicConstraints)
    if constraints is None or not constraints.ca:
        yield (
            "chain-not-authority",
            f"{_shown(certificate.subject)} issued a certificate, but is not an authority",
            "name another issuer",
        )
        return
    intermediates = sum(1 for each in below if each.subject != each.issuer)
    most = constraints.path_length
    if most is not None and intermediates > most:
        yield (
            "chain-path-length",
            f"{_shown(certificate.subject)} has pathlen:{most}, and {intermediates} authorities are below it",
            "raise its pathlen, or name another issuer",
        )
    if not extensions.may(certificate, "keyCertSign"):
        yield (
            "chain-key-usage",
            f"the keyUsage of {_shown(certificate.subject)} lacks keyCertSign",
            "add it, or name another issuer",
        )


def _shown(name: x509.Name) -> str:
    return repr(distinguished_names.to_text(name))
