# SPDX-License-Identifier: Apache-2.0
"""What the configurations of a router and of its sessions must be, so that the router alone decides.

Each requirement is stated here by itself, and not taken from what the compiler writes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

from comarmor.errors import Origin
from comarmor.values import dataclass
from keymint.api import Package
from keymint_ros2_zenoh.documents.configuration import Configuration
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
    check = _Check(found, file)
    wanted = settings_of(package).router.endpoint
    yield from check(
        "mode", found.mode == "client", f"the mode is {found.mode}, and only a client sends all to routers"
    )
    yield from check("connect/endpoints", found.connect == (wanted,), f"it does not connect to {wanted} alone")
    yield from check("listen/endpoints", not found.listen, "it listens, so that others reach it past the router")
    yield from _scouting(check, found)
    yield from _links(check, found)
    tls = found.tls
    yield from check(
        "transport/link/tls/verify_name_on_connect", tls.verify_name, "it does not check the router's name"
    )
    yield from _paths(check, found, package, connects=True)
    control = found.access_control
    closed = control.enabled and control.default_permission is Permission.DENY
    yield from check("access_control", closed, "its access control does not refuse everyone but the router")
    for subject in control.subjects:
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
    check = _Check(found, file)
    yield from check("mode", found.mode == "router", f"the mode is {found.mode}, not router")
    yield from check("connect/endpoints", not found.connect, "it connects to others, whose rights are not in its file")
    for endpoint in found.listen:
        secured = endpoint.partition("/")[0] in AUTHENTICATED
        yield from check("listen/endpoints", secured, f"it listens on {endpoint}, where links have no certificate")
        # They override the settings of TLS, such as the authority: tls/[::]:7447#root_ca_certificate_file=/tmp/ca.pem
        plain = not any(mark in endpoint for mark in "?#")
        yield from check("listen/endpoints", plain, f"it listens on {endpoint}, which has settings of its own")
    yield from _scouting(check, found)
    yield from _links(check, found)
    yield from _paths(check, found, package, connects=False)


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


class _Check:
    """Makes shortcomings of one configuration."""

    def __init__(self, found: Configuration, file: str) -> None:
        self._found = found
        self._file = file

    def __call__(self, path: str, met: bool, message: str) -> Iterator[Shortcoming]:
        if not met:
            yield Shortcoming(message, self._found.place(path, self._file))


_Checker = Callable[[str, bool, str], Iterator[Shortcoming]]


def _scouting(check: _Checker, found: Configuration) -> Iterator[Shortcoming]:
    yield from check("scouting/gossip/enabled", not found.gossip, "gossip is on, which tells others how to bypass it")
    yield from check(
        "scouting/multicast/enabled", not found.multicast, "multicast scouting is on, which anyone answers"
    )


def _links(check: _Checker, found: Configuration) -> Iterator[Shortcoming]:
    secured = bool(found.protocols) and set(found.protocols) <= set(AUTHENTICATED)
    yield from check("transport/link/protocols", secured, "links of protocols without certificates are possible")
    yield from check("transport/link/tls/enable_mtls", found.tls.mutual, "only one side of a link shows a certificate")
    message = "a link outlives its certificate"
    yield from check("transport/link/tls/close_link_on_expiration", found.tls.close_expired, message)


def _paths(check: _Checker, found: Configuration, package: Package, *, connects: bool) -> Iterator[Shortcoming]:
    """Yield the files that are not those of the enclave, to which all other claims refer."""
    folder = enclave_folder(settings_of(package).keystore, package.subject)
    side = "connect" if connects else "listen"
    tls = found.tls
    named = {
        "root_ca_certificate": (tls.root_ca, IDENTITY_CA),
        f"{side}_certificate": (tls.connect_certificate if connects else tls.listen_certificate, CERTIFICATE),
        f"{side}_private_key": (tls.connect_key if connects else tls.listen_key, KEY),
    }
    for path, (value, name) in named.items():
        message = f"{path} is not the file {folder}/{name}"
        yield from check(f"transport/link/tls/{path}", value == f"{folder}/{name}", message)
