# SPDX-License-Identifier: Apache-2.0
"""Translate DDS endpoints into ROS 2 entities: topics, services, and the actions and parameters made of these.

Names of topics are as in design.ros2.org, "Topic and Service name mapping to DDS". Bouncy and later put the prefix into
the topic's name: ``rt/chatter`` in the default partition. Ardent put prefix and namespace into the partition:
``chatter`` in ``rt``, ``chatter`` in ``rt/robot1``. No name fits both.
"""

from __future__ import annotations

from collections.abc import Iterator

from comarmor.regex import lazy_regex
from comarmor.rules import PARTS, is_fully_qualified, parts
from keymint.api.graph import Edge, Graph, Object
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
