# SPDX-License-Identifier: Apache-2.0
"""What a router must permit for an edge of a graph."""

from __future__ import annotations

from comarmor.rules import parts
from keymint.api import Endpoint
from keymint.api.graph import Edge
from keymint.errors import KeymintError
from keymint_ros2_zenoh.keyexpr.key_expr import literal
from keymint_ros2_zenoh.lowering.message_slots import SLOTS, action
from keymint_ros2_zenoh.lowering.name_keys import check_distro, name_key
from keymint_ros2_zenoh.lowering.name_rules import KINDS


def actions(distro: str, edge: Edge) -> tuple[Endpoint, ...]:
    """Return the messages that the router must permit for an edge; their key expressions leave type and hash open.

    There are none if no key can have the name, e.g. ``/a/``.

    Args:
        distro: ROS 2 distribution whose name mapping applies.
        edge: an edge on a ROS name.

    Raises:
        KeymintError: the distribution has no rmw_zenoh, or Zenoh has no such permission on an object of this kind.
    """
    check_distro(distro)
    kind, permission, domain = edge.object.kind, edge.permission, edge.domain
    found: list[Endpoint] = []
    for _, part, suffix in parts(kind, permission):
        if kind not in KINDS or part not in SLOTS:
            raise KeymintError(f"Zenoh has no permission {permission!r} on a {kind}", code="permission-unknown")
        name = literal(f"{edge.object.name}{suffix}".removeprefix("/"))
        if name is None:
            return ()
        for slot in SLOTS[part]:
            key = name_key(domain, name, slot.place)
            found.append(Endpoint(edge.subject, action(slot.message, slot.flow), key.text, domain=domain))
    return tuple(found)
