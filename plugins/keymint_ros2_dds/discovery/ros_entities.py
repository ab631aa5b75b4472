# SPDX-License-Identifier: Apache-2.0
"""Translate names of DDS topics back to ROS 2 (design.ros2.org, "Topic and Service name mapping to DDS").

Bouncy and later put the prefix into the topic's name: ``rt/chatter`` in the default partition. Ardent put prefix and
namespace into the partition: ``chatter`` in ``rt``, ``chatter`` in ``rt/robot1``. No name fits both.
"""

from __future__ import annotations

from comarmor.regex import lazy_regex
from comarmor.ros_names import is_fully_qualified
from comarmor.values import dataclass
from keymint.api.graph import Object

_TYPE = lazy_regex(r"([A-Za-z]\w*(?:::[A-Za-z]\w*)*)::dds_::([A-Za-z]\w*)_\Z")
_SUFFIXES = {"rt": "", "rq": "Request", "rr": "Reply"}


@dataclass(frozen=True, slots=True)
class RosName:
    """The ROS entity of a DDS topic.

    Attributes:
        part: ``rt`` a topic, ``rq`` the requests of a service, ``rr`` its replies.
        name: the topic's or service's name.
    """

    part: str
    name: str


def ros_name(topic: Object) -> RosName | None:
    """Return the ROS entity of a DDS topic, or None if no mapping produces its name.

    Args:
        topic: an object of kind ``topic``.
    """
    if not topic.partitions:
        whole = topic.name
    elif len(topic.partitions) == 1 and "/" not in topic.name:
        whole = f"{topic.partitions[0]}/{topic.name}"
    else:
        return None
    part, slash, rest = whole.partition("/")
    suffix = _SUFFIXES.get(part)
    if suffix is None or not rest.endswith(suffix):
        return None
    name = slash + rest.removesuffix(suffix)
    return RosName(part, name) if is_fully_qualified(name) else None


def ros_type(dds_type: str, part: str) -> str:
    """Return the ROS type of a DDS type: ``std_msgs::msg::dds_::String_`` is ``std_msgs/msg/String``.

    Args:
        dds_type: the DDS type's name.
        part: as :attr:`RosName.part`; the types of requests and replies give that of the service.
    """
    match = _TYPE.match(dds_type)
    if match is None:
        return dds_type
    name = match[2]
    if part != "rt":
        name = name.removesuffix("_Request" if part == "rq" else "_Response")
    return "/".join([*match[1].split("::"), name])
