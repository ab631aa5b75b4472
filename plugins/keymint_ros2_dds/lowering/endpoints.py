# SPDX-License-Identifier: Apache-2.0
"""Maps edges on ROS names to the DDS endpoints that they need, and DDS endpoints back to such edges."""

from __future__ import annotations

from functools import lru_cache

from keymint.api import Endpoint
from keymint.api.graph import Edge, Object
from keymint.errors import KeymintError
from keymint_ros2_dds.lowering.name_mapping import ARDENT, check_distro, has_kind, needed_topics

_KINDS = {
    "ros_publish": "ros_topic", "ros_subscribe": "ros_topic", "ros_call": "ros_service", "ros_execute": "ros_service",
}  # fmt: skip


@lru_cache(maxsize=64)
def _dds_topics(distro: str, kind: str, permission: str) -> tuple[tuple[str, str, str], ...]:
    """Return action, prefix and suffix of each endpoint of a permission."""
    check_distro(distro)
    if not has_kind(distro, kind):
        raise KeymintError(f"ROS 2 {distro.capitalize()} has no {kind}", code="distro-kind")
    try:
        topics = needed_topics(kind, (permission,))
    except KeyError as error:
        raise KeymintError(f"DDS knows no permission {error} of a {kind}", code="permission-unknown") from None
    return tuple((str(topic.action), topic.prefix, suffix + topic.suffix) for topic, suffix in topics)


def endpoints(distro: str, edge: Edge) -> tuple[Edge, ...]:
    """Return the edges of kind ``topic`` that an edge needs; an edge of that kind needs only itself.

    Args:
        distro: ROS 2 distribution whose name mapping applies.
        edge: an edge of any kind.

    Raises:
        KeymintError: the distribution or the permission is unknown.
    """
    if edge.object.kind == "topic":
        return (edge,)
    result = []
    for action, prefix, suffix in _dds_topics(distro, edge.object.kind, edge.permission):
        topic = Object("topic", f"{prefix}{edge.object.name}{suffix}")
        if distro == ARDENT:  # all but the base name is a partition
            partition, _, base = topic.name.rpartition("/")
            topic = Object("topic", base, (partition,))
        result.append(Edge(edge.subject, action, topic, edge.domain))
    return tuple(result)


def meanings(distro: str, endpoint: Edge) -> tuple[Edge, ...]:
    """Return the edges on ROS names that need an endpoint; none of them is composite.

    Args:
        distro: ROS 2 distribution whose name mapping applies.
        endpoint: an edge of kind ``topic``.

    Raises:
        KeymintError: the distribution is unknown.
    """
    result = []
    topic = endpoint.object
    # The ROS names, with prefix and suffix, that map to the topic, each with the remaining partitions.
    paths: list[tuple[str, tuple[str, ...]]] = [(topic.name, topic.partitions)]
    if distro == ARDENT:
        paths = [(f"{partition}/{topic.name}", ()) for partition in topic.partitions]
    for path, partitions in paths:
        for permission, kind in _KINDS.items():
            for action, prefix, suffix in _dds_topics(distro, kind, permission):
                if action == endpoint.permission and path.startswith(f"{prefix}/") and path.endswith(suffix):
                    name = path[len(prefix) : len(path) - len(suffix)]
                    result.append(Edge(endpoint.subject, permission, Object(kind, name, partitions), endpoint.domain))
    return tuple(result)


def actions(distro: str, edge: Edge) -> tuple[Endpoint, ...]:
    """Return what a DDS implementation must permit for an edge; see :meth:`keymint.api.BuildType.actions`.

    Raises:
        KeymintError: the distribution or the permission is unknown.
    """
    return tuple(
        Endpoint(each.subject, each.permission, each.object.name, each.object.partitions, each.domain)
        for each in endpoints(distro, edge)
    )
