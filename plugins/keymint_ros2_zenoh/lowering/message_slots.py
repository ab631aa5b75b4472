# SPDX-License-Identifier: Apache-2.0
"""What each permission needs at the router: messages in both flows, on the keys of a name and beside them.

Measured with Zenoh 1.10.2, by leaving out each of them. Ingress is from the subject to the router.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product, starmap

from comarmor.values import dataclass
from keymint_ros2_zenoh.lowering.name_keys import Place
from keymint_ros2_zenoh.messages import Flow, Message


@dataclass(frozen=True, slots=True, order=True)
class Slot:
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
