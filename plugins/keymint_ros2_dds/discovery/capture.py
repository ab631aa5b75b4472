# SPDX-License-Identifier: Apache-2.0
"""What was discovered in a DDS domain: participants and endpoints, and the graph of named subjects that they make.

How a participant announces its name differs between releases. The first of these is used:

1. the name that the user gives for its GUID;
2. the enclave in its user data (``enclave=/x;``, Foxy and later) unless that is ``/``, which every unsecured one has;
3. node and namespace in its user data (``name=x;namespace=/y;``, Bouncy to Eloquent);
4. its entity name, when that is a legal name (``talker``, Ardent), completed by the namespace of the parameters that
   it serves or calls where these tell one;
5. the one node whose parameters it serves (any ROS 2: a node serves its own);
6. the one node whose type descriptions it serves (Iron and later); helper nodes with a generated name are left out if
   there is another one;
7. a name made from its GUID, with a warning.

The topic ``ros_discovery_info`` lists the nodes of a participant, but not the endpoints of each. Since Foxy permissions
are granted to enclaves, hence to participants.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping

from comarmor.errors import Diagnostic, Severity
from comarmor.regex import lazy_regex
from comarmor.text import first_few
from comarmor.values import dataclass
from keymint.api import DiscoveredGraph
from keymint.api.graph import Edge, Graph, Object, is_generated
from keymint.api.graph_json import legal_node, legal_text, partitions
from keymint.errors import usage_error
from keymint_ros2_dds.discovery.endpoint_translation import ros_edge


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


_GUID = lazy_regex(r"[0-9a-f]{8,32}\Z")
_PARAMETERS, _TYPES = "/get_parameters", "/get_type_description"
_ASKED = "--subject GUID=NAME"
_MOST = 4
"""Number of GUIDs in a message."""


def name_participants(
    participants: Collection[DiscoveredParticipant], endpoints: Iterable[DiscoveredEndpoint], given: Mapping[str, str]
) -> tuple[dict[str, str], list[Diagnostic]]:
    """Return the subject of each participant by GUID, and notes about the origin of its name.

    Args:
        participants: participants.
        endpoints: their endpoints.
        given: subjects by GUID or the beginning of one, as the user typed them.

    Raises:
        KeymintError: the user gave an invalid GUID or an illegal name.
    """
    names = _given(participants, given)
    serves: dict[str, set[str]] = defaultdict(set)
    describes: dict[str, set[str]] = defaultdict(set)
    meets: dict[str, set[str]] = defaultdict(set)
    for endpoint in endpoints:
        found = ros_edge(Edge("", endpoint.permission, endpoint.object))
        if found is None or found.object.kind == "ros_topic" or not found.object.name.endswith((_PARAMETERS, _TYPES)):
            continue
        node, has_parameters = found.object.name.rpartition("/")[0], found.object.name.endswith(_PARAMETERS)
        is_server = (found.permission, endpoint.permission) == ("ros_execute", "subscribe")
        if has_parameters:
            meets[endpoint.participant].add(node)
        if is_server:
            (serves if has_parameters else describes)[endpoint.participant].add(node)
    diagnostics: list[Diagnostic] = []
    for participant in sorted(participants):
        guid, how = participant.guid, "the name that you gave"
        if guid not in names:
            how, names[guid] = _announced(participant, serves[guid], meets[guid], describes[guid])
        shown, name = f"participant {guid} in domain {participant.domain}", names[guid]
        if how:
            diagnostics.append(Diagnostic.note("subject-named", f"{shown} is {name}: {how}", subject=name))
        else:
            message, help_ = f"{shown} does not announce a name; it is named {name}", f"name it with {_ASKED}"
            diagnostics.append(Diagnostic.warning("subject-unknown", message, help=help_, subject=name))
    diagnostics += _shared(participants, names, given)
    return names, diagnostics


def _shared(
    participants: Iterable[DiscoveredParticipant], names: Mapping[str, str], given: Mapping[str, str]
) -> Iterator[Diagnostic]:
    """Yield a finding for each subject of several participants, whose edges are merged.

    Processes of one enclave share its rights on purpose. Otherwise this may be a restart, or two nodes that must not
    get each other's rights. Names that the user gave are not reported.
    """
    merged: dict[tuple[int, str], list[DiscoveredParticipant]] = {}
    for participant in sorted(participants):
        merged.setdefault((participant.domain, names[participant.guid]), []).append(participant)
    for (domain, name), together in merged.items():
        if len(together) < 2 or name in given.values():  # noqa: PLR2004 - nothing is merged
            continue
        enclave = all(_fields(participant.user_data).get("enclave") == name for participant in together)
        guids = first_few([participant.guid for participant in together], _MOST)
        yield Diagnostic(
            "subject-shared",
            Severity.NOTE if enclave else Severity.WARNING,
            f"{len(together)} participants in domain {domain} are named {name} ({guids}): the graph has them as one "
            "subject, with the edges of all",
            help=f"fine for a process that was restarted; distinguish others with {_ASKED}",
            subject=name,
        )


def _announced(
    participant: DiscoveredParticipant, serves: set[str], meets: set[str], describes: set[str]
) -> tuple[str, str]:
    """Return how a participant announces its name, and the name; nothing and one of its GUID if it does not.

    Args:
        participant: the participant.
        serves: the nodes whose parameters it serves.
        meets: the nodes whose parameters it serves or calls.
        describes: the nodes whose type descriptions it serves.
    """
    fields = _fields(participant.user_data)
    enclave = fields.get("enclave", "")
    if legal_node(enclave):
        return "the enclave in its user data", enclave
    node = f"{fields.get('namespace', '/').rstrip('/')}/{fields.get('name', '')}"
    if legal_node(node):
        return "node and namespace in its user data", node
    name = participant.name if participant.name.startswith("/") else f"/{participant.name}"
    if legal_node(name):
        full_names = {node for node in meets if node.endswith(name)}
        return "the participant's name", full_names.pop() if len(full_names) == 1 else name
    served = list(filter(legal_node, serves))
    if len(served) == 1:
        return "the node whose parameters it serves", served[0]
    described = list(filter(legal_node, describes))
    described = [node for node in described if not is_generated(node)] or described
    if len(described) == 1 and not served:
        return "the node whose type descriptions it serves", described[0]
    return "", f"/participant_{participant.guid[:24]}"


def _fields(user_data: bytes) -> dict[str, str]:
    """Return the fields of user data like ``enclave=/x;`` (rmw_dds_common) or ``name=x;namespace=/;`` (rmw)."""
    text = user_data.decode("ascii", errors="replace").rstrip("\0")
    return {name: value for name, equals, value in (item.partition("=") for item in text.split(";")) if equals}


def _given(participants: Collection[DiscoveredParticipant], given: Mapping[str, str]) -> dict[str, str]:
    names: dict[str, str] = {}
    for typed, name in given.items():
        guid = re.sub(r"[.:|\s]", "", typed).lower()
        if not _GUID.match(guid):
            raise usage_error(
                f"{typed!r} is not a GUID", "8 to 32 hexadecimal digits, as 'keymint discover -v' shows them"
            )
        if not legal_node(name):
            raise usage_error(
                f"{name!r} is not the name of a subject", "a name is '/' and segments, e.g. /robot1/talker"
            )
        for participant in participants:
            if participant.guid.startswith(guid):
                names[participant.guid] = name
    return names


def discovered_graph(
    participants: Collection[DiscoveredParticipant], endpoints: Collection[DiscoveredEndpoint], names: Mapping[str, str]
) -> DiscoveredGraph:
    """Return what was discovered as a graph whose objects are DDS topics.

    Args:
        participants: the participants, in any order.
        endpoints: their endpoints, in any order.
        names: subjects that the user gives, by GUID or the beginning of one.
    """
    sound = [seen for seen in endpoints if _sound(seen)]
    subjects, diagnostics = name_participants(participants, sound, names)
    domains = {participant.guid: participant.domain for participant in participants}
    diagnostics += [
        Diagnostic.warning(
            "endpoint-odd",
            f"an endpoint of {subjects[guid]} is left out: its topic, type or partition is no name, or too long",
            subject=subjects[guid],
        )
        for guid in sorted({seen.participant for seen in endpoints if not _sound(seen)})
    ]
    edges = [
        Edge(subjects[seen.participant], seen.permission, seen.object, domains[seen.participant]) for seen in sound
    ]
    types = [(seen.object, seen.type) for seen in sound if seen.type]
    return DiscoveredGraph(Graph.of(edges, subjects.values(), types), tuple(diagnostics))


def _sound(seen: DiscoveredEndpoint) -> bool:
    """Tell whether an endpoint's names are legal; anyone on the network can announce anything."""
    return bool(seen.topic) and all(map(legal_text, (seen.topic, seen.type, *seen.partitions)))
