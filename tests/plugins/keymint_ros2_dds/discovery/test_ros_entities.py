# SPDX-License-Identifier: Apache-2.0
"""Names and types of DDS topics back to ROS, for both mappings."""

from __future__ import annotations

import pytest
from keymint_ros2_dds.discovery.ros_entities import RosName, ros_name, ros_type

from keymint.api.graph import Object


def topic(name: str, *partitions: str) -> Object:
    return Object("topic", name, partitions)


@pytest.mark.parametrize(
    ("found", "expected"),
    [
        (topic("rt/chatter"), RosName("rt", "/chatter")),
        (topic("rt/a/b"), RosName("rt", "/a/b")),
        (topic("rq/a/addRequest"), RosName("rq", "/a/add")),
        (topic("rr/addReply"), RosName("rr", "/add")),
        (topic("chatter", "rt"), RosName("rt", "/chatter")),
        (topic("chatter", "rt/a/b"), RosName("rt", "/a/b/chatter")),
        (topic("addRequest", "rq"), RosName("rq", "/add")),
        (topic("addReply", "rr/a"), RosName("rr", "/a/add")),
        (topic("ros_discovery_info"), None),
        (topic("rt"), None),
        (topic("rt/"), None),
        (topic("rt//a"), None),
        (topic("rt/1"), None),
        (topic("rx/a"), None),
        (topic("rq/add"), None),
        (topic("rq/Request"), None),
        (topic("rr/addRequest"), None),
        (topic("rt/chatter", "rt"), None),
        (topic("rt/chatter", "secret"), None),
        (topic("chatter", "rt", "rt/a"), None),
        (topic("chatter", "*"), None),
        (topic("addRequest", ""), None),
    ],
)
def test_names(found: Object, expected: RosName | None) -> None:
    assert ros_name(found) == expected


@pytest.mark.parametrize(
    ("dds", "part", "ros"),
    [
        ("std_msgs::msg::dds_::String_", "rt", "std_msgs/msg/String"),
        ("example_interfaces::srv::dds_::AddTwoInts_Request_", "rq", "example_interfaces/srv/AddTwoInts"),
        ("example_interfaces::srv::dds_::AddTwoInts_Response_", "rr", "example_interfaces/srv/AddTwoInts"),
        ("Shape", "rt", "Shape"),
    ],
)
def test_types(dds: str, part: str, ros: str) -> None:
    assert ros_type(dds, part) == ros
