# SPDX-License-Identifier: Apache-2.0
"""The configuration of a Zenoh router or session, as data: the settings that access depends on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from operator import attrgetter
from typing import Any

from comarmor.errors import Origin
from comarmor.values import dataclass
from keymint_ros2_zenoh.documents.access_control import AccessControl
from keymint_ros2_zenoh.messages import Permission

DEFAULT_LISTEN: Mapping[str, tuple[str, ...]] = {
    "router": ("tcp/[::]:7447",),
    "peer": ("tcp/[::]:0",),
    "client": (),
}
"""Where a router, peer or client listens if its configuration does not say (Zenoh 1.10, ``DEFAULT_CONFIG.json5``)."""


@dataclass(frozen=True, slots=True)
class Tls:
    """The settings ``transport/link/tls``, with Zenoh's defaults.

    Attributes:
        root_ca: path of the certificates that the other side's certificate must lead to.
        listen_certificate: path of the certificate of the listening side.
        listen_key: path of its private key.
        connect_certificate: path of the certificate of the connecting side.
        connect_key: path of its private key.
        mutual: the connecting side shows its certificate, and the listening side requires one.
        verify_name: the host to connect to must be in the certificate of the listening side.
        close_expired: a link ends when the certificate of the other side expires.
    """

    root_ca: str = ""
    listen_certificate: str = ""
    listen_key: str = ""
    connect_certificate: str = ""
    connect_key: str = ""
    mutual: bool = False
    verify_name: bool = True
    close_expired: bool = False


TLS = "transport/link/tls"
SETTINGS: Mapping[str, str] = {
    "mode": "mode",
    "connect/endpoints": "connect",
    "listen/endpoints": "listen",
    "scouting/gossip/enabled": "gossip",
    "scouting/multicast/enabled": "multicast",
    "transport/link/protocols": "protocols",
    f"{TLS}/root_ca_certificate": "tls.root_ca",
    f"{TLS}/listen_certificate": "tls.listen_certificate",
    f"{TLS}/listen_private_key": "tls.listen_key",
    f"{TLS}/connect_certificate": "tls.connect_certificate",
    f"{TLS}/connect_private_key": "tls.connect_key",
    f"{TLS}/enable_mtls": "tls.mutual",
    f"{TLS}/verify_name_on_connect": "tls.verify_name",
    f"{TLS}/close_link_on_expiration": "tls.close_expired",
}
"""The attributes of :class:`Configuration` by the paths of their settings, in the order of documents."""


@dataclass(frozen=True, slots=True)
class Configuration:
    """What a configuration means in its mode: settings that it lacks have Zenoh's default.

    Attributes:
        mode: ``router``, ``peer`` or ``client``.
        connect: endpoints to connect to, ``protocol/host:port``.
        listen: endpoints to listen on.
        gossip: sessions tell each other how to reach others.
        multicast: sessions search others by multicast.
        protocols: link protocols that are allowed; empty for all.
        tls: certificates and keys.
        access_control: the access control.
        other: settings that this type has no attribute for, by their path (``transport/unicast/max_sessions``).
        places: places of the settings that were read, by their path.
    """

    mode: str = "peer"
    connect: tuple[str, ...] = ()
    listen: tuple[str, ...] = ()
    gossip: bool = True
    multicast: bool = True
    protocols: tuple[str, ...] = ()
    tls: Tls = field(default_factory=Tls)
    access_control: AccessControl = field(default_factory=lambda: AccessControl(False, Permission.DENY))
    other: Mapping[str, Any] = field(default_factory=dict)
    places: Mapping[str, Origin] = field(default_factory=dict, compare=False, repr=False)

    def settings(self) -> dict[str, Any]:
        """Return the settings that have an attribute, by their path."""
        return {path: attrgetter(attribute)(self) for path, attribute in SETTINGS.items()}

    def place(self, path: str, file: str) -> Origin:
        """Return the place of a setting, or of the closest one around it, or the file.

        Args:
            path: path of the setting, e.g. ``scouting/gossip/enabled``.
            file: the file as the user would type it.
        """
        while path:
            if path in self.places:
                return self.places[path]
            path = path.rpartition("/")[0]
        return Origin(file)
