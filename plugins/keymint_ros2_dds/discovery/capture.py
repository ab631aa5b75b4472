# SPDX-License-Identifier: Apache-2.0
"""The participants and endpoints that were discovered in a DDS domain."""

from __future__ import annotations

from comarmor.values import dataclass
from keymint.api.graph import Object
from keymint.api.graph_json import partitions


@dataclass(frozen=True, slots=True, order=True)
class DiscoveredParticipant:
    """A participant (DDS 1.4, 2.2.5, ``DCPSParticipant``).

    Attributes:
        guid: 32 hexadecimal digits.
        domain: DDS domain id.
        name: its entity name, or empty.
        user_data: its user data.
    """

    guid: str
    domain: int
    name: str = ""
    user_data: bytes = b""


@dataclass(frozen=True, slots=True, order=True)
class DiscoveredEndpoint:
    """A writer or reader (DDS 1.4, 2.2.5, ``DCPSPublication`` and ``DCPSSubscription``).

    Attributes:
        participant: GUID of its participant.
        permission: ``publish`` or ``subscribe``.
        topic: DDS name of the topic.
        type: DDS name of the type, or empty.
        partitions: partitions of its publisher or subscriber.
    """

    participant: str
    permission: str
    topic: str
    type: str = ""
    partitions: tuple[str, ...] = ()

    @property
    def object(self) -> Object:
        """The topic as an object of a graph."""
        return Object("topic", self.topic, partitions(set(self.partitions)))


@dataclass(frozen=True, slots=True)
class Capture:
    """Participants and endpoints, in any order; an endpoint's participant is one of them."""

    participants: tuple[DiscoveredParticipant, ...]
    endpoints: tuple[DiscoveredEndpoint, ...]
