# SPDX-License-Identifier: Apache-2.0
"""What edges need of Zenoh, in messages on literal keys."""

from __future__ import annotations

import pytest
from keymint_ros2_zenoh.lowering.permissions import Operation, operations

from keymint.api.graph import Edge, Object

KEY = "0/chatter/std_msgs::msg::dds_::String_/TypeHashNotSupported"
BESIDE = f"{KEY}/@adv/pub/0123456789abcdef/1/_"


def needed(permission: str) -> set[str]:
    return {str(request) for request in Operation(permission, KEY).requests}


def test_a_publisher_sends_and_serves_late_subscribers() -> None:
    assert {f"put in on {KEY}", f"declare subscriber out on {KEY}", f"reply in on {KEY}"} < needed("ros_publish")
    assert {f"declare queryable in on {BESIDE}", f"query out on {BESIDE}"} < needed("ros_publish")


def test_a_client_asks_and_a_server_answers() -> None:
    assert needed("ros_call") == {f"query in on {KEY}", f"reply out on {KEY}", f"declare queryable out on {KEY}"}
    assert needed("ros_execute") == {f"declare queryable in on {KEY}", f"reply in on {KEY}", f"query out on {KEY}"}


def test_the_domain_is_the_first_chunk() -> None:
    (found,) = operations(Edge("/s", "ros_publish", Object("ros_topic", "/chatter"), 7))
    assert found == Operation("ros_publish", "7" + KEY[1:])


def test_an_action_is_three_services_and_two_topics() -> None:
    found = operations(Edge("/s", "ros_request", Object("ros_action", "/a")))
    assert [each.permission for each in found] == ["ros_call"] * 3 + ["ros_subscribe"] * 2
    assert found[0].key.startswith("0/a/_action/send_goal/")


@pytest.mark.parametrize("name", ["/a//b", "/", "/a*", "/a$*", "/**", "/a#b", "/a?b", "/a/"])
def test_no_key_has_a_name_that_zenoh_cannot_write(name: str) -> None:
    assert operations(Edge("/s", "ros_publish", Object("ros_topic", name))) == ()


def test_kinds_that_zenoh_does_not_have_need_nothing_and_are_denied() -> None:
    assert operations(Edge("/s", "publish", Object("topic", "rt/chatter"))) == ()
