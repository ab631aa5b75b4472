# SPDX-License-Identifier: Apache-2.0
"""Names and types of DDS topics back to ROS, for both mappings."""

from __future__ import annotations

import pytest
from keymint_ros2_dds.discovery.capture import ros_edge, ros_type

from keymint.api.graph import Edge, Object


def topic(name: str, *partitions: str) -> Object:
    return Object("topic", name, partitions)


@pytest.mark.parametrize(
    ("found", "expected"),
    [
        (topic("rt/chatter"), Object("ros_topic", "/chatter")),
        (topic("rt/a/b"), Object("ros_topic", "/a/b")),
        (topic("rq/a/addRequest"), Object("ros_service", "/a/add")),
        (topic("rr/addReply"), Object("ros_service", "/add")),
        (topic("chatter", "rt"), Object("ros_topic", "/chatter")),
        (topic("chatter", "rt/a/b"), Object("ros_topic", "/a/b/chatter")),
        (topic("addRequest", "rq"), Object("ros_service", "/add")),
        (topic("addReply", "rr/a"), Object("ros_service", "/a/add")),
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
def test_names(found: Object, expected: Object | None) -> None:
    for permission in ("publish", "subscribe"):
        edge = ros_edge(Edge("/a", permission, found, 3))
        assert (edge and edge.object) == expected
        assert edge is None or (edge.subject, edge.domain) == ("/a", 3)


@pytest.mark.parametrize(
    ("permission", "name", "expected"),
    [
        ("publish", "rt/a", "ros_publish"),
        ("subscribe", "rt/a", "ros_subscribe"),
        ("publish", "rq/aRequest", "ros_call"),
        ("subscribe", "rr/aReply", "ros_call"),
        ("subscribe", "rq/aRequest", "ros_execute"),
        ("publish", "rr/aReply", "ros_execute"),
    ],
)
def test_permissions(permission: str, name: str, expected: str) -> None:
    edge = ros_edge(Edge("/a", permission, topic(name)))
    assert edge is not None
    assert edge.permission == expected


@pytest.mark.parametrize(
    ("dds", "permission", "ros"),
    [
        ("std_msgs::msg::dds_::String_", "ros_publish", "std_msgs/msg/String"),
        ("example_interfaces::srv::dds_::AddTwoInts_Request_", "ros_call", "example_interfaces/srv/AddTwoInts"),
        ("example_interfaces::srv::dds_::AddTwoInts_Response_", "ros_execute", "example_interfaces/srv/AddTwoInts"),
        ("Shape", "ros_publish", "Shape"),
    ],
)
def test_types(dds: str, permission: str, ros: str) -> None:
    assert ros_type(dds, permission) == ros
