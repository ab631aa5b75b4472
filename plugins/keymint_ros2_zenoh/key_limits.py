# SPDX-License-Identifier: Apache-2.0
"""What Zenoh's TLS accepts of keys and certificates (measured with Zenoh 1.10.2, which has rustls)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from ipaddress import ip_address

from comarmor.errors import Diagnostic, Severity
from keymint.api import CertificateSpec, Package
from keymint_ros2_zenoh.settings import is_address, is_router, settings_of

_CURVES = ("SECP256R1", "SECP384R1")
_REFUSED_WITH_EC = "SHA512"
_SERVER, _CLIENT = "serverAuth", "clientAuth"


def check_identity(package: Package) -> Iterator[Diagnostic]:
    """Yield what a router or session would refuse of a package's key and certificate, and of their authorities."""
    subject, identity = package.subject, package.identity
    yield from _curve(identity, "the key", subject)
    if identity.key.uri:
        yield Diagnostic(
            "zenoh-key-token", Severity.ERROR,
            "the private key lies in a token, and Zenoh reads keys from files only",
            identity.origin, "leave out <pkcs11>", subject,
        )  # fmt: skip
    if identity.key.password_env:
        yield Diagnostic(
            "zenoh-key-encrypted", Severity.ERROR,
            "the private key is encrypted, and Zenoh cannot read such a key",
            identity.origin, "leave out the password; the file has mode 0600", subject,
        )  # fmt: skip
    for authority in package.issuers:
        yield from _curve(authority.certificate, f"the key of the authority {authority.name!r}", subject)
    yield from _signatures(package)
    yield from _usage(package, is_server=is_router(package))
    if is_router(package):
        yield from _host(package)


def _curve(certificate: CertificateSpec, what: str, subject: str) -> Iterator[Diagnostic]:
    if certificate.key.algorithm == "ec" and certificate.key.curve not in _CURVES:
        yield Diagnostic(
            "zenoh-key-curve", Severity.ERROR,
            f"{what} is on the curve {certificate.key.curve}, which Zenoh refuses",
            certificate.origin, "use prime256v1 or secp384r1, or RSA", subject,
        )  # fmt: skip


def _signatures(package: Package) -> Iterator[Diagnostic]:
    """Yield the certificates below the root that an EC key signs with SHA-512, which rustls does not verify."""
    signed = [package.identity, *(authority.certificate for authority in package.issuers)]
    for certificate, authority in zip(signed, package.issuers, strict=False):
        if authority.certificate.key.algorithm == "ec" and certificate.hash_algorithm == _REFUSED_WITH_EC:
            yield Diagnostic(
                "zenoh-key-hash", Severity.ERROR,
                f"the authority {authority.name!r} has an EC key and signs this certificate with SHA512, which Zenoh "
                "refuses",
                certificate.origin, "use SHA256 or SHA384", package.subject,
            )  # fmt: skip


def _usage(package: Package, *, is_server: bool) -> Iterator[Diagnostic]:
    """Yield what contradicts the role of the certificate: a router is a server, all others are clients."""
    needed, other = (_SERVER, _CLIENT) if is_server else (_CLIENT, _SERVER)
    for extension in package.identity.extensions:
        if extension.name != "extendedKeyUsage":
            continue
        usages = [part.strip() for part in extension.value.split(",")]
        if needed not in usages:
            yield Diagnostic(
                "zenoh-key-usage", Severity.ERROR,
                f"the certificate's extendedKeyUsage lacks {needed}, and Zenoh refuses it",
                extension.origin, f"add {needed}, or leave out the extension", package.subject,
            )  # fmt: skip
        elif other in usages:
            yield Diagnostic(
                "zenoh-key-usage", Severity.WARNING,
                _too_much(is_server=is_server), extension.origin, "leave out the extension", package.subject,
            )  # fmt: skip


def _host(package: Package) -> Iterator[Diagnostic]:
    """Yield a name of the router's certificate that the sources give, and sessions do not look for."""
    host = settings_of(package).router.host
    needed = f"{'IP' if is_address(host) else 'DNS'}:{host}"
    for extension in package.identity.extensions:
        if extension.name == "subjectAltName" and not any(
            _same_name(part.strip(), needed) for part in extension.value.split(",")
        ):
            yield Diagnostic(
                "zenoh-host-name", Severity.ERROR,
                f"the certificate's subjectAltName lacks the router's host {host!r}, so that no session connects to it",
                extension.origin, f"add {needed}, or leave out the extension", package.subject,
            )  # fmt: skip


def _same_name(one: str, other: str) -> bool:
    """Return whether two names of a certificate are the same: addresses in any notation, DNS names in any case."""
    kind, _, value = one.partition(":")
    if kind == "IP" and other.startswith("IP:") and is_address(value):
        return ip_address(value) == ip_address(other.removeprefix("IP:"))
    return one.casefold() == other.casefold()


def _too_much(*, is_server: bool) -> str:
    if is_server:
        return "the router's certificate is also for clients, and could take part as a node without rights"
    return "the certificate is also for servers: its holder could pretend to be a router where names are not checked"


def errors(diagnostics: Sequence[Diagnostic]) -> list[Diagnostic]:
    """Return the diagnostics that stop a build."""
    return [each for each in diagnostics if each.severity is Severity.ERROR]
