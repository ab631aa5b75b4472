# SPDX-License-Identifier: Apache-2.0
"""What a package says about Zenoh beside its rules: the router, where the keystore lies on the robot, and authorities.

One authority issues identities, one signs the router's configuration.
"""

from __future__ import annotations

from collections.abc import Sequence
from ipaddress import ip_address

from comarmor.values import Data, field
from keymint.api import AuthorityRole, Implementation, Package
from keymint.errors import Origin

BUILD_TYPE = "keymint_ros2_zenoh"
"""The name by which packages ask for this build type."""


class Router(Data):
    """The router that all enclaves connect to.

    Attributes:
        name: name of its package, whose certificate it shows.
        host: DNS name or IP address by which sessions reach it.
        port: its port.
        origin: where its host is written.
    """

    name: str
    host: str
    port: int
    origin: Origin = field(compare=False)

    @property
    def endpoint(self) -> str:
        """The endpoint that sessions connect to."""
        return f"tls/{in_endpoint(self.host)}:{self.port}"


class ZenohSettings(Data):
    """The payload of this build type in a package.

    Attributes:
        router: the router of its workspace.
        keystore: absolute path of the install space on the robot, without a ``/`` at its end.
    """

    router: Router
    keystore: str


def settings_of(package: Package) -> ZenohSettings:
    """Return what this build type read from the sources of a package that it builds."""
    settings = package.settings[BUILD_TYPE]
    if not isinstance(settings, ZenohSettings):
        raise TypeError(f"the settings of {package.name} are those of another build type")
    return settings


def is_router(package: Package) -> bool:
    """Return whether a package is that of the router."""
    return package.name == settings_of(package).router.name


def in_endpoint(host: str) -> str:
    """Return a host as endpoints have it: an IPv6 address stands in brackets."""
    return f"[{host}]" if ":" in host else host


def is_address(host: str) -> bool:
    """Return whether a host is an IP address."""
    try:
        ip_address(host)
    except ValueError:
        return False
    return True


IDENTITY, ACCESS = "identity", "access"
_ALL = frozenset({IDENTITY, ACCESS})
IMPLEMENTATIONS = (Implementation("zenoh", "Zenoh 1", bundles=_ALL, reissues=_ALL),)
"""What Zenoh accepts while an authority changes: TLS trusts every authority of a file, by name and key. Only Keymint
verifies the signature of the router's configuration."""


def implementations() -> Sequence[Implementation]:
    """Return what was measured: see :meth:`keymint.api.BuildType.implementations`."""
    return IMPLEMENTATIONS


def authorities(package: Package) -> tuple[AuthorityRole, ...]:
    """Return the authorities of a package; see :meth:`keymint.api.BuildType.authorities`."""
    identity, grant = package.identity, package.grant
    return (
        AuthorityRole(IDENTITY, identity.issuer, identity.origin),
        AuthorityRole(ACCESS, grant.issuer, grant.origin, signs=True),
    )
