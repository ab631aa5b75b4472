# SPDX-License-Identifier: Apache-2.0
"""The configuration of a Zenoh router or session, as data: the settings on which access depends, as documents say them.

Its member ``access_control`` is that of Zenoh 1.6 and later: it decides on messages. It is written as JSON with
comments, which every JSON5 reader reads, the same bytes for the same data.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import fields
from enum import StrEnum
from typing import Any

from comarmor.values import Data, field
from keymint.errors import Origin


class Message(StrEnum):
    """Messages that access control decides on."""

    PUT = "put"
    DELETE = "delete"
    DECLARE_SUBSCRIBER = "declare_subscriber"
    QUERY = "query"
    REPLY = "reply"
    DECLARE_QUERYABLE = "declare_queryable"
    LIVELINESS_TOKEN = "liveliness_token"  # noqa: S105 - no password
    LIVELINESS_QUERY = "liveliness_query"
    DECLARE_LIVELINESS_SUBSCRIBER = "declare_liveliness_subscriber"


class Flow(StrEnum):
    """Direction of a message on a link, as seen from the process whose configuration decides."""

    INGRESS = "ingress"
    EGRESS = "egress"

    @property
    def opposite(self) -> Flow:
        """The flow at the other end of the link: what enters the router leaves the session, and the reverse."""
        return Flow.EGRESS if self is Flow.INGRESS else Flow.INGRESS


class Permission(StrEnum):
    """Effect of a rule, or the default."""

    ALLOW = "allow"
    DENY = "deny"


class AclRule(Data):
    """A rule: it applies to a message if its flow and message are listed and a key expression includes the key.

    Attributes:
        id: its name in the document.
        messages: messages.
        flows: flows; both if the document gives none.
        permission: allow or deny.
        key_exprs: key expressions in canonical form.
        where: its place in the document; None for a rule that was not read.
    """

    id: str
    messages: tuple[Message, ...]
    flows: tuple[Flow, ...]
    permission: Permission
    key_exprs: tuple[str, ...]
    where: Origin | None = None


PROPERTIES = ("cert_common_names", "usernames", "interfaces", "link_protocols", "zids")
"""The properties of :class:`AclSubject`, which have the same names in a document."""


class AclSubject(Data):
    """Links that a policy applies to: one of the values of each property that is given; an empty property is any.

    Attributes:
        id: its name in the document.
        cert_common_names: first common names of certificates.
        usernames: user names.
        interfaces: network interfaces.
        link_protocols: link protocols: ``tls``, ``quic``, ``tcp``, …
        zids: identifiers of sessions, which nothing authenticates.
        where: its place in the document; None for a subject that was not read.
    """

    id: str
    cert_common_names: tuple[str, ...] = ()
    usernames: tuple[str, ...] = ()
    interfaces: tuple[str, ...] = ()
    link_protocols: tuple[str, ...] = ()
    zids: tuple[str, ...] = ()
    where: Origin | None = None

    @property
    def properties(self) -> tuple[tuple[str, ...], ...]:
        """The values of each of :data:`PROPERTIES`."""
        return tuple(getattr(self, name) for name in PROPERTIES)

    @property
    def depends_on_more(self) -> bool:
        """Whether it gives other properties than common names."""
        return any(self.properties[1:])


class AclPolicy(Data):
    """Rules that apply to subjects, both by their names in the document."""

    rules: tuple[str, ...]
    subjects: tuple[str, ...]
    where: Origin | None = None


class AccessControl(Data):
    """The access control of a configuration.

    Attributes:
        enabled: without it everything is allowed.
        default_permission: the decision if no rule applies.
        rules: rules.
        subjects: subjects.
        policies: which rules apply to which subjects.
        where: its place in the document; None if it was not read.
    """

    enabled: bool
    default_permission: Permission
    rules: tuple[AclRule, ...] = ()
    subjects: tuple[AclSubject, ...] = ()
    policies: tuple[AclPolicy, ...] = ()
    where: Origin | None = None


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


class Configuration(Data):
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
        places: places of the settings that were read, by their path; that of the empty path is the file.
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

    def place(self, path: str) -> Origin:
        """Return the place of a setting of a configuration that was read, or of the closest one around it, or the file.

        Args:
            path: path of the setting, e.g. ``scouting/gossip/enabled``.
        """
        while path and path not in self.places:
            path = path.rpartition("/")[0]
        return self.places[path]


SETTINGS: Mapping[str, str] = {each.metadata["path"]: each.name for each in fields(Configuration) if each.metadata}
"""The attributes of :class:`Configuration` by the paths of their settings, in the order of documents."""

ROUTER_SETTINGS: Mapping[str, Any] = {
    "timestamping/enabled": True,
    "transport/link/tx/keep_alive": 2,
    "transport/link/tx/lease": 60_000,
    "transport/shared_memory/enabled": False,
    "transport/unicast/accept_pending": 10_000,
    "transport/unicast/accept_timeout": 60_000,
    "transport/unicast/max_sessions": 10_000,
    "transport/unicast/open_timeout": 60_000,
}
"""Settings of both default configurations of rmw_zenoh (0.12, ``rmw_zenoh_cpp/config``) that differ from Zenoh's.

A configuration replaces these defaults, so it must repeat them. ``transient_local`` needs time stamps.
"""
SESSION_SETTINGS: Mapping[str, Any] = {
    **ROUTER_SETTINGS,
    "queries_default_timeout": 600_000,
    "transport/link/tx/queue/congestion_control/block/wait_before_close": 60_000_000,
}


_WIDTH = 120


def write(configuration: Configuration, title: Sequence[str]) -> bytes:
    """Return a configuration as a file.

    Every setting that a :class:`Configuration` has an attribute for is written, also if it has Zenoh's default.

    Args:
        configuration: what the file says.
        title: lines of the comment at its beginning.
    """
    given = configuration.settings().items()
    settings = {path: value for path, value in given if value not in ("", ()) or path.endswith("/endpoints")}
    tree: dict[str, Any] = {}  # the settings as nested objects
    for path, value in (settings | dict(sorted(configuration.other.items()))).items():
        *parents, name = path.split("/")
        place = tree
        for parent in parents:
            place = place.setdefault(parent, {})
        place[name] = value
    control = configuration.access_control
    decisions = [
        f'    "enabled": {json.dumps(control.enabled)}',
        f'    "default_permission": {json.dumps(control.default_permission)}',
        _list("rules", control.rules, ("id", "permission", "flows", "messages", "key_exprs")),
        _list("subjects", control.subjects, ("id", *PROPERTIES)),
        _list("policies", control.policies, ("subjects", "rules")),
    ]
    members = [f"  {json.dumps(key)}: {_value(value, 2)}" for key, value in tree.items()]
    members.append("\n".join(['  "access_control": {', ",\n".join(decisions), "  }"]))
    return "\n".join([*(f"// {line}".rstrip() for line in title), "{", ",\n".join(members), "}", ""]).encode()


def _list(name: str, items: Iterable[AclRule | AclSubject | AclPolicy], members: Sequence[str]) -> str:
    """Return a member with one item on each line, or more lines for an item that does not fit.

    Args:
        name: of the member.
        items: its items.
        members: the members of an item, which are its attributes; a property that is not given is left out.
    """
    given = ({each: getattr(item, each) for each in members} for item in items)
    written = ({each: value for each, value in item.items() if value or each not in PROPERTIES} for item in given)
    lines = ",\n".join(f"      {_value(item, 6)}" for item in written)
    return f'    "{name}": [\n{lines}\n    ]' if lines else f'    "{name}": []'


def _value(value: Any, indent: int) -> str:
    """Return a value on one line if it fits, else one member on each line.

    Other characters than ASCII are escaped, so that no reader mistakes one.
    """
    line = json.dumps(value)
    if indent + len(line) < _WIDTH or not value or not isinstance(value, dict | list | tuple):
        return line
    inner = " " * (indent + 2)
    if not isinstance(value, dict):
        return "\n".join(["[", *_filled([_value(item, indent + 2) for item in value], inner), " " * indent + "]"])
    parts = [f"{inner}{json.dumps(key)}: {_value(item, indent + 2)}" for key, item in value.items()]
    return "\n".join(["{", ",\n".join(parts), " " * indent + "}"])


def _filled(parts: Sequence[str], indent: str) -> Iterator[str]:
    """Yield lines of as many parts as fit."""
    line = ""
    for number, part in enumerate(parts, 1):
        item = part + ("," if number < len(parts) else "")
        if line and len(indent) + len(line) + len(item) >= _WIDTH:
            yield indent + line
            line = ""
        line = f"{line} {item}" if line else item
    yield indent + line
