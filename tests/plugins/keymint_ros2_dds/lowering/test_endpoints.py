# SPDX-License-Identifier: Apache-2.0
"""Edges on ROS names and the DDS endpoints that they stand for."""

from __future__ import annotations

import pytest
from hypothesis import given, strategies as st
from keymint_ros2_dds.lowering.endpoints import endpoints, meanings

from keymint.api.graph import LABELLED, Edge, Object
from keymint.errors import KeymintError

NAMES = st.lists(st.sampled_from(["a", "b_1", "Request", "Reply", "rt"]), min_size=1, max_size=3).map(
    lambda parts: "".join(f"/{part}" for part in parts)
)


def needed(permission: str, name: str) -> list[tuple[str, str]]:
    kind = next(kind for kind, permissions in LABELLED.items() if permission in permissions)
    found = endpoints("humble", Edge("/s", permission, Object(kind, name)))
    assert all(each.object.kind == "topic" and each.subject == "/s" for each in found)
    return [(each.permission, each.object.name) for each in found]


def test_topics_and_services() -> None:
    assert needed("ros_publish", "/a/b") == [("publish", "rt/a/b")]
    assert needed("ros_call", "/s") == [("publish", "rq/sRequest"), ("subscribe", "rr/sReply")]
    assert needed("ros_execute", "/s") == [("subscribe", "rq/sRequest"), ("publish", "rr/sReply")]
    assert needed("subscribe", "raw") == [("subscribe", "raw")]


def test_composites() -> None:
    assert ("subscribe", "rt/m/_action/status") in needed("ros_request", "/m")
    assert ("publish", "rt/m/_action/feedback") in needed("ros_operate", "/m")
    assert len(needed("ros_read", "/n")) == 8
    assert ("publish", "rq/n/set_parameters_atomicallyRequest") in needed("ros_write", "/n")


@given(NAMES, st.sampled_from(["ros_publish", "ros_subscribe", "ros_call", "ros_execute"]))
def test_meanings_are_the_inverse(name: str, permission: str) -> None:
    kind = "ros_topic" if permission in LABELLED["ros_topic"] else "ros_service"
    edge = Edge("/s", permission, Object(kind, name), 3)
    for endpoint in endpoints("humble", edge):
        assert edge in meanings("humble", endpoint)
        for meaning in meanings("humble", endpoint):
            assert endpoint in endpoints("humble", meaning)


@pytest.mark.parametrize("topic", ["", "rt", "rtx", "x/rt/a", "rq/sReply", "rr/sRequest", "rq/s", "ros_discovery_info"])
def test_a_topic_that_is_no_image_means_nothing_else(topic: str) -> None:
    assert meanings("humble", Edge("/s", "publish", Object("topic", topic))) == ()


def test_an_unknown_distro() -> None:
    with pytest.raises(KeymintError, match="humbl"):
        endpoints("humbl", Edge("/s", "ros_publish", Object("ros_topic", "/a")))
