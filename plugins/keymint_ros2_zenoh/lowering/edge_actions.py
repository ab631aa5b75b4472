# SPDX-License-Identifier: Apache-2.0
"""What a router must permit for an edge of a graph."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache

from comarmor.rules import parts
from keymint.api import Endpoint
from keymint.api.graph import Edge
from keymint.errors import KeymintError
from keymint_ros2_zenoh.keyexpr.key_expr import literal
from keymint_ros2_zenoh.lowering.message_slots import SLOTS, Place, Slot, action
from keymint_ros2_zenoh.lowering.name_keys import advanced_key, check_distro, data_key
from keymint_ros2_zenoh.lowering.name_rules import KINDS


def actions(distro: str, edge: Edge) -> tuple[Endpoint, ...]:
    """Return the messages that the router must permit for an edge; their key expressions leave type and hash open.

    There are none if no key can have the name, e.g. ``/a/``.

    Args:
        distro: ROS 2 distribution whose name mapping applies.
        edge: an edge on a ROS name.

    Raises:
        KeymintError: the distribution has no rmw_zenoh, or Zenoh cannot express edges of this kind.
    """
    return tuple(_endpoints(edge, slots_of(distro, edge.object.kind, edge.permission)))


@lru_cache(maxsize=64)
def slots_of(distro: str, kind: str, permission: str) -> tuple[tuple[Slot, str], ...]:
    """Return what a permission needs: slots, each with what follows the name.

    Raises:
        KeymintError: the distribution has no rmw_zenoh, or Zenoh has no such permission.
    """
    check_distro(distro)
    result = []
    for _, part, suffix in parts(kind, permission):
        if kind not in KINDS or part not in SLOTS:
            raise KeymintError(f"Zenoh has no permission {permission!r} on a {kind}", code="permission-unknown")
        result += [(slot, suffix) for slot in SLOTS[part]]
    return tuple(result)


def _endpoints(edge: Edge, slots: tuple[tuple[Slot, str], ...]) -> Iterator[Endpoint]:
    for slot, suffix in slots:
        name = literal(f"{edge.object.name}{suffix}".removeprefix("/"))
        if name is None:
            return
        data = data_key(edge.domain, name)
        key = data if slot.place is Place.DATA else advanced_key(data)
        yield Endpoint(edge.subject, action(slot.message, slot.flow), key.text, domain=edge.domain)
