# SPDX-License-Identifier: Apache-2.0
"""What the configurations of a router and of its sessions must be, so that the router alone decides.

Each requirement is stated here by itself, and not taken from what the compiler writes.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from comarmor.errors import Origin
from comarmor.values import dataclass
from keymint.api import Package
from keymint_ros2_zenoh.documents.configuration import TLS, Configuration
from keymint_ros2_zenoh.emission import ROUTER_SETTINGS, SESSION_SETTINGS
from keymint_ros2_zenoh.enclave_layout import CERTIFICATE, IDENTITY_CA, KEY, enclave_folder
from keymint_ros2_zenoh.messages import Permission
from keymint_ros2_zenoh.settings import settings_of

AUTHENTICATED = ("tls", "quic")
"""Links whose other end shows a certificate."""


@dataclass(frozen=True, slots=True)
class Shortcoming:
    """A setting that lets someone past the router.

    Attributes:
        message: one line.
        where: its place.
    """

    message: str
    where: Origin


def of_session(found: Configuration, package: Package, router_name: str, file: str) -> Iterator[Shortcoming]:
    """Yield what lets the sessions of an enclave exchange messages with others than the router.

    Args:
        found: the installed configuration.
        package: the enclave's package.
        router_name: common name of the router's certificate.
        file: the installed file as the user would type it.
    """
    yield from _unmet(found, file, _of_session(found, package))
    for subject in found.access_control.subjects:
        if subject.common_names != (router_name,):
            message = f"the subject {subject.id!r} of its access control is not the router {router_name!r} alone"
            yield Shortcoming(message, subject.where or Origin(file))


def of_router(found: Configuration, package: Package, file: str) -> Iterator[Shortcoming]:
    """Yield what lets messages reach the router without an identity, or pass it without a decision.

    Args:
        found: the installed configuration.
        package: the router's package.
        file: the installed file as the user would type it.
    """
    return _unmet(found, file, _of_router(found, package))


def unmodelled(found: Configuration, router: bool) -> str:
    """Return a setting whose effect on access is not known, in words; empty if there is none.

    A setting that is missing has Zenoh's default, which is another value than the known one.

    Args:
        found: the configuration.
        router: it is a router's.
    """
    known: Mapping[str, Any] = ROUTER_SETTINGS if router else SESSION_SETTINGS
    for path, value in found.other.items():
        if path not in known or known[path] != value:
            return f"what the setting {path} does to access is not known"
    missing = next((path for path in known if path not in found.other), "")
    return missing and f"the setting {missing} is missing; what its default does to access is not known"


_Requirement = tuple[str, bool, str]
"""The path of a setting, whether it is as it must be, and what is wrong if it is not."""


def _unmet(found: Configuration, file: str, requirements: Iterable[_Requirement]) -> Iterator[Shortcoming]:
    return (Shortcoming(message, found.place(path, file)) for path, met, message in requirements if not met)


def _of_session(found: Configuration, package: Package) -> Iterator[_Requirement]:
    wanted, control = settings_of(package).router.endpoint, found.access_control
    yield "mode", found.mode == "client", f"the mode is {found.mode}, and only a client sends all to routers"
    yield "connect/endpoints", found.connect == (wanted,), f"it does not connect to {wanted} alone"
    yield "listen/endpoints", not found.listen, "it listens, so that others reach it past the router"
    yield from _of_both(found)
    yield f"{TLS}/verify_name_on_connect", found.tls.verify_name, "it does not check the router's name"
    yield from _paths(found, package, "connect")
    closed = control.enabled and control.default_permission is Permission.DENY
    yield "access_control", closed, "its access control does not refuse everyone but the router"


def _of_router(found: Configuration, package: Package) -> Iterator[_Requirement]:
    yield "mode", found.mode == "router", f"the mode is {found.mode}, not router"
    yield "connect/endpoints", not found.connect, "it connects to others, whose rights are not in its file"
    for endpoint in found.listen:
        secured = endpoint.partition("/")[0] in AUTHENTICATED
        yield "listen/endpoints", secured, f"it listens on {endpoint}, where links have no certificate"
        # They override the settings of TLS, such as the authority: tls/[::]:7447#root_ca_certificate_file=/tmp/ca.pem
        plain = not any(mark in endpoint for mark in "?#")
        yield "listen/endpoints", plain, f"it listens on {endpoint}, which has settings of its own"
    yield from _of_both(found)
    yield from _paths(found, package, "listen")


def _of_both(found: Configuration) -> Iterator[_Requirement]:
    yield "scouting/gossip/enabled", not found.gossip, "gossip is on, which tells others how to bypass it"
    yield "scouting/multicast/enabled", not found.multicast, "multicast scouting is on, which anyone answers"
    secured = bool(found.protocols) and set(found.protocols) <= set(AUTHENTICATED)
    yield "transport/link/protocols", secured, "links of protocols without certificates are possible"
    yield f"{TLS}/enable_mtls", found.tls.mutual, "only one side of a link shows a certificate"
    yield f"{TLS}/close_link_on_expiration", found.tls.close_expired, "a link outlives its certificate"


def _paths(found: Configuration, package: Package, side: str) -> Iterator[_Requirement]:
    """Yield that the files are those of the enclave, to which all other claims refer."""
    folder, settings = enclave_folder(settings_of(package).keystore, package.subject), found.settings()
    files = {"root_ca_certificate": IDENTITY_CA, f"{side}_certificate": CERTIFICATE, f"{side}_private_key": KEY}
    for name, file in files.items():
        path, wanted = f"{TLS}/{name}", f"{folder}/{file}"
        yield path, settings[path] == wanted, f"{name} is not the file {wanted}"
