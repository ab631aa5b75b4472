"""What was seen of a DDS domain: participants and their endpoints; as data, and as a graph in terms of DDS."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from comarmor.errors import Diagnostic, Severity
from keymint.api import DiscoveredGraph
from keymint.graph import Edge, Graph, Object
from keymint.graph_json import legal_text, partitions
from keymint_ros2_dds.discovery.participant_names import name_participants


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
        """The topic, as graphs have it."""
        return Object("topic", self.topic, partitions(set(self.partitions)))


@dataclass(frozen=True, slots=True)
class Capture:
    """Participants and endpoints, in any order; an endpoint's participant is one of them."""

    participants: tuple[DiscoveredParticipant, ...]
    endpoints: tuple[DiscoveredEndpoint, ...]


def discovered(capture: Capture, names: Mapping[str, str]) -> DiscoveredGraph:
    """Return a capture as a graph whose objects are DDS topics.

    Args:
        capture: what was seen.
        names: subjects by GUID or the beginning of one, where the user knows better.
    """
    sound = [seen for seen in capture.endpoints if _sound(seen)]
    subjects, diagnostics = name_participants(capture.participants, sound, names)
    domains = {participant.guid: participant.domain for participant in capture.participants}
    diagnostics += [
        Diagnostic(
            "endpoint-odd",
            Severity.WARNING,
            f"an endpoint of {subjects[guid]} is left out: its topic, type or partition is no name, or too long",
            subject=subjects[guid],
        )
        for guid in sorted({seen.participant for seen in capture.endpoints if not _sound(seen)})
    ]
    edges = [
        Edge(subjects[seen.participant], seen.permission, seen.object, domains[seen.participant]) for seen in sound
    ]
    types = [(seen.object, seen.type) for seen in sound if seen.type]
    return DiscoveredGraph(Graph.of(edges, subjects.values(), types), tuple(diagnostics))


def _sound(seen: DiscoveredEndpoint) -> bool:
    """Tell whether an endpoint's names can be written down; anyone on the network can announce anything."""
    return bool(seen.topic) and all(map(legal_text, (seen.topic, seen.type, *seen.partitions)))
