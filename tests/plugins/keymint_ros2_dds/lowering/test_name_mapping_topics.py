# SPDX-License-Identifier: Apache-2.0
"""The DDS topics that each permission needs."""

from __future__ import annotations

import pytest
from keymint_ros2_dds.lowering.name_mapping import DDS_TOPICS, TopicAction

from comarmor.rules import PERMISSIONS, parts

OPPOSITE = {"publish": "subscribe", "subscribe": "publish"}


def topics(kind: str, permission: str) -> set[tuple[TopicAction, str, str]]:
    """Return action, prefix and suffix of the topics of a permission, its parts included."""
    return {
        (topic.action, topic.prefix, suffix + topic.suffix)
        for _, part, suffix in parts(kind, permission)
        for topic in DDS_TOPICS[part]
    }


@pytest.mark.parametrize("kind", PERMISSIONS)
def test_every_permission_of_the_language_needs_topics(kind: str) -> None:
    assert all(topics(kind, permission) for permission in PERMISSIONS[kind])


@pytest.mark.parametrize(
    ("kind", "one", "other"),
    [
        ("topic", "publish", "subscribe"),
        ("ros_topic", "ros_publish", "ros_subscribe"),
        ("ros_service", "ros_call", "ros_execute"),
        ("ros_action", "ros_request", "ros_operate"),
    ],
)
def test_what_one_side_publishes_the_other_subscribes(kind: str, one: str, other: str) -> None:
    reversed_ = {(OPPOSITE[action], prefix, suffix) for action, prefix, suffix in topics(kind, one)}
    assert reversed_ == topics(kind, other)


@pytest.mark.parametrize("permission", ["ros_read", "ros_write"])
def test_parameters_are_services_that_are_called(permission: str) -> None:
    needed = topics("ros_parameter", permission)
    assert {(action, prefix) for action, prefix, _ in needed} == {
        ("publish", "rq"),
        ("subscribe", "rr"),
    }
    assert all(suffix.endswith("Request" if prefix == "rq" else "Reply") for _, prefix, suffix in needed)
