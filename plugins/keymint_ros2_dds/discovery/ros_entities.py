# SPDX-License-Identifier: Apache-2.0
"""Translate names of DDS topics back to ROS 2 (design.ros2.org, "Topic and Service name mapping to DDS").

Bouncy and later put the prefix into the topic's name: ``rt/chatter`` in the default partition. Ardent put prefix and
namespace into the partition: ``chatter`` in ``rt``, ``chatter`` in ``rt/robot1``. No name fits both.
"""

from __future__ import annotations

from comarmor.regex import lazy_regex
from comarmor.rules import is_fully_qualified
from keymint.api.graph import Edge
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
