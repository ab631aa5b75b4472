# SPDX-License-Identifier: Apache-2.0
"""What was discovered in a DDS domain: the graph of named subjects that it makes, and what that is in terms of ROS 2.

DDS endpoints become topics, services, and the actions and parameters made of these. Names of topics are as in
design.ros2.org, "Topic and Service name mapping to DDS". Bouncy and later put the prefix into the topic's name:
``rt/chatter`` in the default partition. Ardent put prefix and namespace into the partition: ``chatter`` in ``rt``,
``chatter`` in ``rt/robot1``. No name fits both.

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

from comarmor.rules import PARTS, is_fully_qualified, parts
from comarmor.text import first_few, lazy_regex
from comarmor.values import Data
from keymint.api import DiscoveredGraph
from keymint.api.graph import Edge, Graph, Object, is_generated
from keymint.api.graph_json import legal_node, legal_text, partitions
from keymint.errors import Diagnostic, Severity, usage_error
from keymint_ros2_dds.lowering.endpoints import meanings
from keymint_ros2_dds.lowering.name_mapping import ARDENT

_LATER = "bouncy"
"""Stands for all distributions but Ardent."""
_TYPE = lazy_regex(r"([A-Za-z]\w*(?:::[A-Za-z]\w*)*)::dds_::([A-Za-z]\w*)_\Z")
_SENT = {"ros_publish": "", "ros_call": "_Request", "ros_execute": "_Response"}
"""How the DDS types end that each permission writes."""


def ros_edge(endpoint: Edge) -> Edge | None:
    """Return the edge on a ROS name that needs an endpoint, or None if no mapping produces its name.

    Args:
        endpoint: an edge of any kind; one that is not of kind ``topic`` is no endpoint.
    """
    topic = endpoint.object
    if topic.kind != "topic" or len(topic.partitions) > 1 or (topic.partitions and "/" in topic.name):
        return None
    found = meanings(ARDENT if topic.partitions else _LATER, endpoint)
    return next((edge for edge in found if is_fully_qualified(edge.object.name)), None)


def ros_type(dds_type: str, permission: str) -> str:
    """Return the ROS type of a DDS type: ``std_msgs::msg::dds_::String_`` is ``std_msgs/msg/String``.

    Args:
        dds_type: the DDS type's name.
        permission: that of who writes it; the types of requests and replies give that of the service.
    """
    match = _TYPE.match(dds_type)
    if match is None:
        return dds_type
    return "/".join([*match[1].split("::"), match[2].removesuffix(_SENT[permission])])


_BOTH = {"publish", "subscribe"}
"""Each side of a service writes the one topic of it, and reads the other."""
_FIRST = {parts(*composite)[0]: composite for composite in PARTS}
"""The composite that each first part belongs to."""
_ACTION_SUFFIX = "_SendGoal"

Types = set[tuple[Object, str]]


def interpret(graph: Graph, *, fold: bool) -> Graph:
    """Return a graph in terms of ROS. It loses nothing, and is idempotent.

    Args:
        graph: objects of any kind; DDS topics that fit no mapping, and halves of services, stay DDS topics.
        fold: combine services and topics into actions and parameters where all parts exist; otherwise split these.
    """
    unfolded: set[Edge] = set()
    for edge in graph.edges:
        for kind, permission, suffix in parts(edge.object.kind, edge.permission):
            part = Edge(edge.subject, permission, Object(kind, edge.object.name + suffix), edge.domain)
            unfolded.add(part if suffix else edge)
    types = set(graph.types)
    for object_, name in graph.types:
        if writer := ros_edge(Edge("", "publish", object_)):
            types.add((writer.object, ros_type(name, writer.permission)))
    edges = set(_ros_edges(unfolded))
    if fold:
        edges, types = _folded(edges, types)
    remaining = {edge.object for edge in edges}
    return Graph.of(edges, graph.subjects, (item for item in types if item[0] in remaining))


def _ros_edges(edges: set[Edge]) -> Iterator[Edge]:
    """Yield edges in terms of ROS; one endpoint of a service is kept unless its subject has both."""
    halves: dict[Edge, set[Edge]] = {}
    for edge in edges:
        found = ros_edge(edge)
        if found is None:
            yield edge
        elif found.object.kind == "ros_topic":
            yield found
        else:
            halves.setdefault(found, set()).add(edge)
    for combined, endpoints in halves.items():
        if {endpoint.permission for endpoint in endpoints} == _BOTH:
            yield combined
        elif combined not in edges:
            yield from endpoints


def _folded(edges: set[Edge], types: Types) -> tuple[set[Edge], Types]:
    """Combine complete entities; a subject that lacks a part keeps the other parts."""
    kept, named = set(edges), set(types)
    of_object: dict[Object, list[str]] = {}
    for object_, name in types:
        of_object.setdefault(object_, []).append(name)
    for edge in edges:
        for (kind, permission, suffix), (composite, whole) in _FIRST.items():
            if (edge.object.kind, edge.permission) != (kind, permission) or not edge.object.name.endswith(suffix):
                continue
            base = edge.object.name.removesuffix(suffix)
            needed = {
                Edge(edge.subject, part_permission, Object(part_kind, base + part), edge.domain)
                for part_kind, part_permission, part in parts(composite, whole)
            }
            if not base or not needed <= edges:
                continue
            kept -= needed
            kept.add(Edge(edge.subject, whole, Object(composite, base), edge.domain))
            named |= {
                (Object(composite, base), name.removesuffix(_ACTION_SUFFIX))
                for name in of_object.get(edge.object, ())
                if composite == "ros_action" and name.endswith(_ACTION_SUFFIX)
            }
    return kept, named


class DiscoveredParticipant(Data, order=True):
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


class DiscoveredEndpoint(Data, order=True):
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
            help_ = "8 to 32 hexadecimal digits, as 'keymint discover -v' shows them"
            raise usage_error(f"{typed!r} is not a GUID", help_)
        if not legal_node(name):
            help_ = "a name is '/' and segments, e.g. /robot1/talker"
            raise usage_error(f"{name!r} is not the name of a subject", help_)
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
