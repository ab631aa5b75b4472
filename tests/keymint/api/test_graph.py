# SPDX-License-Identifier: Apache-2.0
"""Graphs are canonical, and a completion has every permission of every subject on every object."""

from __future__ import annotations

import pytest
from hypothesis import given, strategies as st

from comarmor.rules import PERMISSIONS
from keymint.api.graph import (
    LABELLED,
    ConfusionMatrix,
    Edge,
    EdgeOutcome,
    Graph,
    Object,
    complete,
    differing_names,
    general_expression,
    is_generated,
)

PERMISSION = st.sampled_from([(kind, permission) for kind, all_ in PERMISSIONS.items() for permission in all_])
EDGES = st.lists(
    st.builds(
        lambda subject, held, name, domain: Edge(subject, held[1], Object(held[0], name), domain),
        st.sampled_from(["/a", "/b", "/c"]),
        PERMISSION,
        st.sampled_from(["/x", "/y"]),
        st.integers(0, 1),
    ),
    max_size=6,
)


@given(EDGES, st.permutations(["/a", "/z"]))
def test_a_graph_does_not_depend_on_order_or_repetition(edges, subjects) -> None:
    graph = Graph.of(edges, subjects)
    assert graph == Graph.of([*reversed(edges), *edges], [*subjects, *subjects])
    assert graph.edges == tuple(sorted(set(edges)))
    assert set(graph.subjects) == {"/a", "/z", *(edge.subject for edge in edges)}
    assert list(graph.subjects) == sorted(graph.subjects)
    assert graph.objects == tuple(sorted({(edge.domain, edge.object) for edge in edges}))


@given(EDGES)
def test_a_completion_has_every_permission_that_a_transport_decides(edges) -> None:
    graph = Graph.of(edges, ["/alone"])
    completed = list(complete(graph))
    assert len(set(completed)) == len(completed)
    assert set(completed) == {
        Edge(subject, permission, object_, domain)
        for subject in graph.subjects
        for domain, object_ in graph.objects
        for permission in LABELLED[object_.kind]
    }
    decided = {edge for edge in edges if not edge.permission.endswith("relay")}
    assert decided <= set(completed)
    assert not any(edge.permission.endswith("relay") for edge in completed)
    assert [edge.subject for edge in completed] == sorted(edge.subject for edge in completed)


def test_outcomes_and_their_counts() -> None:
    assert {outcome for outcome in EdgeOutcome if outcome.false} == {
        EdgeOutcome.FALSE_POSITIVE,
        EdgeOutcome.FALSE_NEGATIVE,
    }
    assert {outcome for outcome in EdgeOutcome if outcome.allowed} == {EdgeOutcome.ALLOW, EdgeOutcome.FALSE_POSITIVE}
    matrix = ConfusionMatrix(true_positive=1, false_negative=20, false_positive=300, true_negative=4000)
    assert (matrix.errors, matrix.edges) == (320, 4321)


# -- names of nodes that change with each start ---------------------------------------------------------------------

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
    assert general_expression(name, "ros_service")[0] == (expression or name)
    assert bool(general_expression(name, "ros_service")[1]) == (expression is not None)


def test_parameters_have_the_name_of_their_node() -> None:
    assert general_expression("/launch_ros_17", "ros_parameter")[0] == "/launch_ros_*"
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
    found = list(differing_names(record(before, "/same_7"), record(now, "/same_7")))
    assert len(found) == (pattern is not None)
    for note in found:
        assert (note.code, note.subject) == ("names-differ", "/a")
        assert note.message.startswith(f"{before} in one record, {now} in another")
        assert note.help == f"then write {pattern} in the policy"


def test_what_one_record_has_twice_is_no_matter_of_records() -> None:
    assert list(differing_names(record("/arm_1", "/arm_2"), record("/arm_1", "/arm_2"))) == []
    assert list(differing_names(record("/arm_1"), record("/arm_2", subject="/b"))) == []
