# SPDX-License-Identifier: Apache-2.0
"""Names of nodes that change with each start: the known ones, and those that differ between two records."""

from __future__ import annotations

import pytest

from keymint.api.generated_names import differing, generalised, is_generated
from keymint.api.graph import Edge, Graph, Object

TYPES = "/get_type_description"


@pytest.mark.parametrize(
    ("name", "expression"),
    [
        (f"/transform_listener_impl_5581f0a3b2c0{TYPES}", f"/transform_listener_impl_*{TYPES}"),
        (f"/robot1/transform_listener_impl_ab12{TYPES}", f"/robot1/transform_listener_impl_*{TYPES}"),
        (f"/_ros2cli_4711{TYPES}", f"/_ros2cli_*{TYPES}"),
        (f"/_ros2cli_daemon_42_5f2e0a{TYPES}", f"/_ros2cli_daemon_42_*{TYPES}"),
        (f"/launch_ros_17{TYPES}", f"/launch_ros_*{TYPES}"),
        (f"/moveit_93810{TYPES}", f"/moveit_*{TYPES}"),
        ("rr/_ros2cli_5/listReply", "rr/_ros2cli_*/listReply"),
        # Not generated, but derived, or somebody's own name.
        (f"/controller_server_rclcpp_node{TYPES}", None),
        (f"/moveit_servo{TYPES}", None),
        (f"/my_launch_ros_17{TYPES}", None),
        (f"/launch_ros_17b{TYPES}", None),
        (f"/transform_listener_impl_x1{TYPES}", None),
        ("/arm_1/state", None),
        ("/moveit_2", None),  # a topic, not a node
    ],
)
def test_only_the_generated_part_of_a_known_name(name: str, expression: str | None) -> None:
    assert generalised(name, "ros_service")[0] == (expression or name)
    assert bool(generalised(name, "ros_service")[1]) == (expression is not None)


def test_parameters_have_the_name_of_their_node() -> None:
    assert generalised("/launch_ros_17", "ros_parameter")[0] == "/launch_ros_*"
    assert is_generated("/launch_ros_17")
    assert not is_generated("/arm_1")


def record(*names: str, subject: str = "/a") -> Graph:
    return Graph.of(Edge(subject, "ros_publish", Object("ros_topic", name)) for name in names)


@pytest.mark.parametrize(
    ("before", "now", "pattern"),
    [
        ("/driver_8812/status", "/driver_9120/status", "/driver_*/status"),
        ("/job_8f3a_done", "/job_91bc_done", "/job_*_done"),
        ("/node12/x", "/node345/x", "/node*/x"),
        ("/arm_1", "/arm_2", "/arm_*"),
        ("/left", "/light", None),
        ("/arm_1", "/leg_2", None),
        ("/arm_1/a", "/arm_2/b", None),
        (f"/_ros2cli_1{TYPES}", f"/_ros2cli_2{TYPES}", None),  # known, and widened
    ],
)
def test_names_that_two_records_have_in_different_forms(before: str, now: str, pattern: str | None) -> None:
    found = list(differing(record(before, "/same_7"), record(now, "/same_7")))
    assert len(found) == (pattern is not None)
    for note in found:
        assert (note.code, note.subject) == ("names-differ", "/a")
        assert note.message.startswith(f"{before} in one record, {now} in another")
        assert note.help == f"then write {pattern} in the policy"


def test_what_one_record_has_twice_is_no_matter_of_records() -> None:
    assert list(differing(record("/arm_1", "/arm_2"), record("/arm_1", "/arm_2"))) == []
    assert list(differing(record("/arm_1"), record("/arm_2", subject="/b"))) == []
