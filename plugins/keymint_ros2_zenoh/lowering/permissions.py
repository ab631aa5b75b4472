# SPDX-License-Identifier: Apache-2.0
"""What a ROS permission is on Zenoh: the keys of names, the messages on them, and the operations of a node.

The keys are those that rmw_zenoh 0.1 (Humble) to 0.12 (Rolling) uses. The topic or service ``/a/b`` has the key
``<domain>/a/b/<type>/<hash>``. Beside it, a publisher or subscriber that is ``transient_local`` uses ``<key>/@adv/…``.
A token of the graph is ``@ros2_lv/<domain>/<session>/<node>/<entity>/<kind>/<enclave>/…``, where ``%`` replaces each
``/`` of the enclave.

A permission needs messages at the router in both flows, on the keys of a name and beside them: measured with Zenoh
1.10.2, by leaving out each of them. Ingress is from the subject to the router.

An operation is what a node does for an edge. In its literal key the parts that no right depends on are fixed: type and
hash, and the identifiers behind ``@adv``.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from enum import StrEnum
from itertools import product, starmap

from comarmor.rules import parts
from comarmor.text import did_you_mean
from comarmor.values import Data
from keymint.api import Endpoint
from keymint.api.graph import Edge
from keymint.errors import KeymintError, Origin
from keymint_ros2_zenoh.documents.configuration import Flow, Message
from keymint_ros2_zenoh.keyexpr import ANY_CHUNK, ANY_CHUNKS, KeyExpr, literal, of_chunks

DISTROS = ("humble", "jazzy", "kilted", "lyrical", "rolling")
"""Distributions that have rmw_zenoh."""
TYPE_AND_HASH = (ANY_CHUNK, ANY_CHUNK)
"""The last two chunks of a key: access control does not depend on them."""
ADVANCED = "@adv"
GRAPH = "@ros2_lv"
_TOKEN_IDS = (ANY_CHUNK,) * 4
"""Session, node, entity, and kind of entity."""
TOKEN_ENCLAVE = 2 + len(_TOKEN_IDS)
"""Index of the enclave among the chunks of a token."""


def check_distro(distro: str, where: Origin | None = None) -> None:
    """Raise an error for a distribution that has no rmw_zenoh.

    Args:
        distro: ROS 2 distribution.
        where: the place of the error.

    Raises:
        KeymintError: it has none.
    """
    if distro not in DISTROS:
        message = f"ROS 2 {distro.capitalize()} has no rmw_zenoh, which this build type is for"
        help_ = did_you_mean(distro, DISTROS, f"use one of {', '.join(DISTROS)}, or the build type of DDS")
        raise KeymintError(message, where=where, help=help_, code="zenoh-distro")


class Place(StrEnum):
    """Which keys of a name: those of its data, or those beside them that serve ``transient_local``."""

    DATA = "data"
    ADVANCED = "advanced"


def name_key(domain: int, name: KeyExpr, place: Place = Place.DATA) -> KeyExpr:
    """Return the keys of topics or services in a domain.

    Args:
        domain: the domain id.
        name: ROS names without the leading ``/``.
        place: which of their keys.
    """
    beside = () if place is Place.DATA else (ADVANCED, ANY_CHUNKS)
    return of_chunks((str(domain), *name.chunks, *TYPE_AND_HASH, *beside))


def graph_key(domain: int) -> KeyExpr:
    """Return the keys of all tokens of the graph in a domain."""
    return of_chunks((GRAPH, str(domain), ANY_CHUNKS))


def own_tokens_key(domain: int, subject: str) -> KeyExpr:
    """Return the keys of the tokens of an enclave, which only nodes that are started in it use."""
    return of_chunks((GRAPH, str(domain), *_TOKEN_IDS, subject.replace("/", "%"), ANY_CHUNKS))


class Slot(Data, order=True):
    """A message in a flow, on the keys of a name at a place."""

    message: Message
    flow: Flow
    place: Place = Place.DATA


def action(message: Message, flow: Flow) -> str:
    """Return a message and a flow in words: ``put in``, ``declare subscriber out``."""
    return f"{message.replace('_', ' ')} {'in' if flow is Flow.INGRESS else 'out'}"


_IN, _OUT, _BESIDE = Flow.INGRESS, Flow.EGRESS, Place.ADVANCED

SLOTS: Mapping[str, tuple[Slot, ...]] = {
    "ros_publish": (
        Slot(Message.PUT, _IN),
        Slot(Message.DECLARE_SUBSCRIBER, _OUT),
        Slot(Message.REPLY, _IN),  # of the cache, to late subscribers
        Slot(Message.PUT, _IN, _BESIDE),  # heartbeats
        Slot(Message.DECLARE_SUBSCRIBER, _OUT, _BESIDE),
        Slot(Message.DECLARE_QUERYABLE, _IN, _BESIDE),
        Slot(Message.QUERY, _OUT, _BESIDE),
        Slot(Message.LIVELINESS_TOKEN, _IN, _BESIDE),
    ),
    "ros_subscribe": (
        Slot(Message.DECLARE_SUBSCRIBER, _IN),
        Slot(Message.PUT, _OUT),
        Slot(Message.REPLY, _OUT),
        Slot(Message.DECLARE_SUBSCRIBER, _IN, _BESIDE),
        Slot(Message.PUT, _OUT, _BESIDE),
        Slot(Message.QUERY, _IN, _BESIDE),
        Slot(Message.DECLARE_LIVELINESS_SUBSCRIBER, _IN, _BESIDE),
        Slot(Message.LIVELINESS_TOKEN, _OUT, _BESIDE),
    ),
    "ros_call": (Slot(Message.QUERY, _IN), Slot(Message.REPLY, _OUT), Slot(Message.DECLARE_QUERYABLE, _OUT)),
    "ros_execute": (Slot(Message.DECLARE_QUERYABLE, _IN), Slot(Message.REPLY, _IN), Slot(Message.QUERY, _OUT)),
}
"""The slots of each permission that is not composite.

Only ``reply`` on data belongs to two permissions of a subject: to publish and to execute, or to subscribe and to call.
A reply needs a query that was permitted to reach the subject. So a reply that is permitted for the one is no right to
the other.
"""
WAYS: Mapping[str, tuple[tuple[Slot, ...], ...]] = {
    "ros_publish": (
        (Slot(Message.PUT, _IN),),
        (Slot(Message.REPLY, _IN), Slot(Message.QUERY, _OUT, _BESIDE), Slot(Message.DECLARE_QUERYABLE, _IN, _BESIDE)),
    ),
    "ros_subscribe": (
        (Slot(Message.DECLARE_SUBSCRIBER, _IN), Slot(Message.PUT, _OUT)),
        (Slot(Message.QUERY, _IN, _BESIDE), Slot(Message.REPLY, _OUT)),
    ),
    "ros_call": ((Slot(Message.QUERY, _IN),),),
    "ros_execute": ((Slot(Message.DECLARE_QUERYABLE, _IN), Slot(Message.QUERY, _OUT)),),
}
"""The ways in which a session that keeps to no convention can use a permission: all slots of a way are enough.

A sample is sent by ``put``, or as the reply of a cache. A query makes a server act, whether or not its reply arrives.
"""
USERS: Mapping[Slot, frozenset[str]] = {
    slot: frozenset(permission for permission, slots in SLOTS.items() if slot in slots)
    for slot in starmap(Slot, product(Message, Flow, Place))
}
"""The permissions that need a slot; for every slot, also for those that no permission needs."""
GRAPH_SLOTS = frozenset(
    ((Message.LIVELINESS_QUERY, _IN), (Message.DECLARE_LIVELINESS_SUBSCRIBER, _IN), (Message.LIVELINESS_TOKEN, _OUT))
)
"""What a node needs to read the graph, besides announcing its own tokens."""


TYPE = "std_msgs::msg::dds_::String_"
HASH = "TypeHashNotSupported"
"""A type, and what Humble has in place of the hash of its definition."""
PUBLISH, SUBSCRIBE, CALL, EXECUTE = "ros_publish", "ros_subscribe", "ros_call", "ros_execute"
OTHER_END: Mapping[str, str] = {PUBLISH: SUBSCRIBE, SUBSCRIBE: PUBLISH, CALL: EXECUTE, EXECUTE: CALL}
"""The operation at the other end of each operation."""
_ADVANCED_IDS = "pub/0123456789abcdef/1/_"


class Operation(Data):
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


class OperationRequest(Data):
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
        if part not in SLOTS:
            raise KeymintError(f"Zenoh has no permission {permission!r} on a {kind}", code="permission-unknown")
        name = literal(f"{edge.object.name}{suffix}".removeprefix("/"))
        if name is None:
            return ()
        for slot in SLOTS[part]:
            key = name_key(domain, name, slot.place)
            found.append(Endpoint(edge.subject, action(slot.message, slot.flow), key.text, domain=domain))
    return tuple(found)
