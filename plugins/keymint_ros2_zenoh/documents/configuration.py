# SPDX-License-Identifier: Apache-2.0
"""The configuration of a Zenoh router or session, as data: the settings that access depends on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field, fields
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


TLS = "transport/link/tls"


def _setting(path: str, default: Any) -> Any:
    """Return the field of a setting, which has Zenoh's default if a document lacks it."""
    return field(default=default, metadata={"path": path})


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
        root_ca: path of the certificates that the other side's certificate must lead to.
        listen_certificate: path of the certificate of the listening side.
        listen_key: path of its private key.
        connect_certificate: path of the certificate of the connecting side.
        connect_key: path of its private key.
        mutual: the connecting side shows its certificate, and the listening side requires one.
        verify_name: the host to connect to must be in the certificate of the listening side.
        close_expired: a link ends when the certificate of the other side expires.
        access_control: the access control.
        other: settings that this type has no attribute for, by their path (``transport/unicast/max_sessions``).
        places: places of the settings that were read, by their path.
    """

    mode: str = _setting("mode", "peer")
    connect: tuple[str, ...] = _setting("connect/endpoints", ())
    listen: tuple[str, ...] = _setting("listen/endpoints", ())
    gossip: bool = _setting("scouting/gossip/enabled", True)
    multicast: bool = _setting("scouting/multicast/enabled", True)
    protocols: tuple[str, ...] = _setting("transport/link/protocols", ())
    root_ca: str = _setting(f"{TLS}/root_ca_certificate", "")
    listen_certificate: str = _setting(f"{TLS}/listen_certificate", "")
    listen_key: str = _setting(f"{TLS}/listen_private_key", "")
    connect_certificate: str = _setting(f"{TLS}/connect_certificate", "")
    connect_key: str = _setting(f"{TLS}/connect_private_key", "")
    mutual: bool = _setting(f"{TLS}/enable_mtls", False)
    verify_name: bool = _setting(f"{TLS}/verify_name_on_connect", True)
    close_expired: bool = _setting(f"{TLS}/close_link_on_expiration", False)
    access_control: AccessControl = field(default_factory=lambda: AccessControl(False, Permission.DENY))
    other: Mapping[str, Any] = field(default_factory=dict)
    places: Mapping[str, Origin] = field(default_factory=dict, compare=False, repr=False)

    def settings(self) -> dict[str, Any]:
        """Return the settings that have an attribute, by their path."""
        return {path: getattr(self, attribute) for path, attribute in SETTINGS.items()}

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


SETTINGS: Mapping[str, str] = {each.metadata["path"]: each.name for each in fields(Configuration) if each.metadata}
"""The attributes of :class:`Configuration` by the paths of their settings, in the order of documents."""
