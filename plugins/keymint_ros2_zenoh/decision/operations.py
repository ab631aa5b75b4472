# SPDX-License-Identifier: Apache-2.0
"""What a node does for an edge: operations on keys, and the messages that each of them needs.

In a literal key the parts that no right depends on are fixed: type and hash, and the identifiers behind ``@adv``.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from comarmor.rules import parts
from comarmor.values import dataclass
from keymint.api import Endpoint
from keymint.api.graph import Edge
from keymint.errors import KeymintError
from keymint_ros2_zenoh.keyexpr.key_expr import literal
from keymint_ros2_zenoh.lowering.message_slots import SLOTS, WAYS, Slot, action
from keymint_ros2_zenoh.lowering.name_keys import ADVANCED, Place, check_distro, name_key
from keymint_ros2_zenoh.lowering.name_rules import KINDS
from keymint_ros2_zenoh.messages import Flow, Message

TYPE = "std_msgs::msg::dds_::String_"
HASH = "TypeHashNotSupported"
"""A type, and what Humble has in place of the hash of its definition."""
PUBLISH, SUBSCRIBE, CALL, EXECUTE = "ros_publish", "ros_subscribe", "ros_call", "ros_execute"
OTHER_END: Mapping[str, str] = {PUBLISH: SUBSCRIBE, SUBSCRIBE: PUBLISH, CALL: EXECUTE, EXECUTE: CALL}
"""The operation at the other end of each operation."""
_ADVANCED_IDS = "pub/0123456789abcdef/1/_"


@dataclass(frozen=True, slots=True)
class Operation:
    """An operation of a node on a literal key.

    Attributes:
        permission: a key of :data:`SLOTS`.
        key: the key of the topic or service.
    """

    permission: str
    key: str

    @property
    def keys(self) -> tuple[str, str]:
        """The key, and the one beside it that serves ``transient_local``."""
        return self.key, f"{self.key}/{ADVANCED}/{_ADVANCED_IDS}"

    @property
    def requests(self) -> tuple[OperationRequest, ...]:
        """The messages that it needs, all of them."""
        return self._requests(SLOTS[self.permission])

    @property
    def ways(self) -> tuple[tuple[OperationRequest, ...], ...]:
        """The ways in which a session that keeps to no convention can do it, each with the messages that are enough."""
        return tuple(map(self._requests, WAYS[self.permission]))

    def _requests(self, slots: Iterable[Slot]) -> tuple[OperationRequest, ...]:
        plain, beside = self.keys
        return tuple(
            OperationRequest(slot.message, slot.flow, plain if slot.place is Place.DATA else beside) for slot in slots
        )


@dataclass(frozen=True, slots=True)
class OperationRequest:
    """A message on a link of a router, on a literal key; the flow is as the router sees it."""

    message: Message
    flow: Flow
    key: str

    def __str__(self) -> str:
        """Return it in words: ``put in on 0/chatter/…``."""
        return f"{action(self.message, self.flow)} on {self.key}"


def operations(edge: Edge) -> tuple[Operation, ...]:
    """Return the operations that an edge needs, all of them; none if no key can have its name."""
    found = []
    for _, permission, suffix in parts(edge.object.kind, edge.permission):
        key = f"{edge.domain}{edge.object.name}{suffix}/{TYPE}/{HASH}"
        if permission not in SLOTS or literal(key) is None:
            return ()
        found.append(Operation(permission, key))
    return tuple(found)


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
