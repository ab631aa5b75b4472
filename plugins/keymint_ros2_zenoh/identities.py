# SPDX-License-Identifier: Apache-2.0
"""The identities of a router and its enclaves: their names, and what Zenoh's TLS accepts of keys and certificates.

Measured with Zenoh 1.10.2, which has rustls.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from ipaddress import ip_address

from keymint.api import CertificateSpec, Extension, Package
from keymint.errors import Defects, Diagnostic, KeymintError, Origin
from keymint.pki import distinguished_names
from keymint_ros2_zenoh.settings import is_address, is_router, settings_of

_CURVES = ("SECP256R1", "SECP384R1")
_SERVER, _CLIENT = "serverAuth", "clientAuth"
_TOO_MUCH = {
    True: "the router's certificate is also for clients, and could take part as a node without rights",
    False: "the certificate is also for servers: its holder could pretend to be a router where names are not checked",
}
"""What is wrong with a certificate for both, if it is the router's, and if not."""
_Defect = tuple[str, str, Origin, str]
"""The code of an error, its message, its place, and what to do about it."""


def check_identity(package: Package) -> Iterator[Diagnostic]:
    """Yield what a router or session would refuse of a package's key and certificate, and of their authorities."""
    for code, message, where, help_ in _refused(package):
        yield Diagnostic.error(code, message, where, help_, package.subject)
    for extension, usages in _listed(package, "extendedKeyUsage"):
        if _SERVER in usages and _CLIENT in usages:
            problem, where = _TOO_MUCH[is_router(package)], extension.origin
            help_ = "leave out the extension"
            yield Diagnostic.warning("zenoh-key-usage", problem, where, help_, package.subject)


def _refused(package: Package) -> Iterator[_Defect]:
    identity = package.identity
    yield from _curve(identity, "the key")
    if identity.key.uri:
        message = "the private key lies in a token, and Zenoh reads keys from files only"
        yield "zenoh-key-token", message, identity.origin, "leave out <pkcs11>"
    for authority in package.issuers:
        yield from _curve(authority.certificate, f"the key of the authority {authority.name!r}")
    # rustls does not verify the signature with SHA-512 by an EC key, which certificates below the root may have.
    signed = [identity, *(authority.certificate for authority in package.issuers)]
    for certificate, authority in zip(signed, package.issuers, strict=False):
        if authority.certificate.key.algorithm == "ec" and certificate.hash_algorithm == "SHA512":
            message = f"the authority {authority.name!r} has an EC key, and Zenoh refuses its signature with SHA512"
            yield "zenoh-key-hash", message, certificate.origin, "use SHA256 or SHA384"
    needed = _SERVER if is_router(package) else _CLIENT
    for extension, usages in _listed(package, "extendedKeyUsage"):
        if needed not in usages:
            message = f"the certificate's extendedKeyUsage lacks {needed}, and Zenoh refuses it"
            yield "zenoh-key-usage", message, extension.origin, f"add {needed}, or leave out the extension"
    if is_router(package):
        # The name that sessions look for must be among those that the sources give.
        host = settings_of(package).router.host
        needed = f"{'IP' if is_address(host) else 'DNS'}:{host}"
        for extension, names in _listed(package, "subjectAltName"):
            if not any(_same_name(name, needed) for name in names):
                message = f"its subjectAltName lacks the router's host {host!r}, so no session connects to it"
                yield "zenoh-host-name", message, extension.origin, f"add {needed}, or leave out the extension"


def _curve(certificate: CertificateSpec, what: str) -> Iterator[_Defect]:
    if certificate.key.algorithm == "ec" and certificate.key.curve not in _CURVES:
        message = f"{what} is on the curve {certificate.key.curve}, which Zenoh refuses"
        yield "zenoh-key-curve", message, certificate.origin, "use prime256v1 or secp384r1, or RSA"


def _listed(package: Package, name: str) -> Iterator[tuple[Extension, list[str]]]:
    """Yield the extensions of this name that the sources give, each with its values."""
    for extension in package.identity.extensions:
        if extension.name == name:
            yield extension, [part.strip() for part in extension.value.split(",")]


def _same_name(one: str, other: str) -> bool:
    """Return whether two names of a certificate are the same: addresses in any notation, DNS names in any case."""
    kind, _, value = one.partition(":")
    if kind == "IP" and other.startswith("IP:") and is_address(value):
        return ip_address(value) == ip_address(other.removeprefix("IP:"))
    return one.casefold() == other.casefold()


def common_name(package: Package) -> str:
    """Return the first common name of a package's certificate, by which a router knows it.

    Raises:
        KeymintError: the subject name has none.
    """
    origin = package.identity.origin
    for kind, value in distinguished_names.attributes(distinguished_names.parse(package.identity.subject_name, origin)):
        if kind == "CN":
            return value
    message = f"the subject name {package.identity.subject_name!r} has no common name, by which routers know a subject"
    raise KeymintError(message, where=origin, help="begin it with CN=", code="zenoh-common-name")


def router_of(package: Package) -> Package:
    """Return the package of the router that a package's sessions connect to.

    Raises:
        KeymintError: the workspace has none.
    """
    wanted = settings_of(package).router
    for other in (package, *package.infrastructure):
        if other.name == wanted.name:
            return other
    message = f"the workspace has no package of the router {wanted.name!r}"
    raise KeymintError(message, where=wanted.origin, help="'keymint create' creates it", code="zenoh-router-missing")


def require_distinct_names(packages: Iterable[Package]) -> None:
    """Check that no two packages have the same common name.

    Raises:
        KeymintError: some have, or a package has none; with all of them.
    """
    holders: dict[str, Package] = {}
    defects = Defects()
    for package in packages:
        with defects:
            name = common_name(package)
            other = holders.setdefault(name, package)
            if other is not package:
                message = (
                    f"{package.subject} and {other.subject} (at {other.identity.origin}) have the same common name "
                    f"{name!r}, by which alone routers know a subject"
                )
                where, help_ = package.identity.origin, "give one of them a subject_name with another CN"
                defects.found.append(Diagnostic.error("zenoh-common-name", message, where, help_, package.subject))
    defects.require_none()


def enclaves_of(packages: Iterable[Package]) -> list[Package]:
    """Return the packages of enclaves: all but the router's."""
    return [package for package in packages if not is_router(package)]
