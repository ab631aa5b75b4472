# SPDX-License-Identifier: Apache-2.0
"""DDS names back to ROS: the inverse of the mapping, for both mappings, and nothing more."""

from __future__ import annotations

from hypothesis import given, settings, strategies as st
from keymint_ros2_dds.discovery.capture import interpret

from comarmor.rules import PARTS
from keymint.api.graph import Edge, Graph, Object
from tests.effort import tries


def topic(name: str, *partitions: str) -> Object:
    return Object("topic", name, partitions)


IMAGES = {
    "ros_publish": (("publish", "rt", ""),),
    "ros_subscribe": (("subscribe", "rt", ""),),
    "ros_call": (("publish", "rq", "Request"), ("subscribe", "rr", "Reply")),
    "ros_execute": (("subscribe", "rq", "Request"), ("publish", "rr", "Reply")),
}
"""Written down here once more, independently of the mapping that the compiler uses."""


def on_dds(edge: Edge, *, ardent: bool) -> list[Edge]:
    """Return what an edge that is not composite is on DDS."""
    seen = []
    for permission, prefix, suffix in IMAGES[edge.permission]:
        namespace, _, base = edge.object.name.rpartition("/")
        modern = topic(prefix + edge.object.name + suffix)
        seen.append(
            Edge(edge.subject, permission, topic(base + suffix, prefix + namespace) if ardent else modern, edge.domain)
        )
    return seen


def unfolded(edge: Edge) -> list[Edge]:
    found = edge.object
    return [
        Edge(edge.subject, permission, Object(kind, found.name + suffix), edge.domain)
        for kind, permission, suffix in PARTS.get((found.kind, edge.permission), ((found.kind, edge.permission, ""),))
    ]


KINDS = {
    "ros_publish": "ros_topic",
    "ros_subscribe": "ros_topic",
    "ros_call": "ros_service",
    "ros_execute": "ros_service",
    "ros_request": "ros_action",
    "ros_operate": "ros_action",
    "ros_read": "ros_parameter",
    "ros_write": "ros_parameter",
}
names = st.sampled_from(["/a", "/b", "/ns/a", "/ns/a/b"])
ros_edges = st.builds(
    lambda subject, permission, name, domain: Edge(subject, permission, Object(KINDS[permission], name), domain),
    st.sampled_from(["/s", "/t"]),
    st.sampled_from(list(KINDS)),
    names,
    st.integers(0, 1),
)


@settings(deadline=None, max_examples=tries(25, 50))
@given(st.lists(ros_edges, max_size=8), st.booleans())
def test_it_is_the_inverse_of_both_mappings(edges: list[Edge], ardent: bool) -> None:
    parts = [part for edge in edges for part in unfolded(edge)]
    seen = Graph.of([one for part in parts for one in on_dds(part, ardent=ardent)])
    assert interpret(seen, fold=False).edges == Graph.of(parts).edges
    assert interpret(seen, fold=True) == interpret(Graph.of(edges), fold=True)
    assert interpret(interpret(seen, fold=True), fold=False) == interpret(seen, fold=False)


@settings(deadline=None, max_examples=tries(25, 50))
@given(st.lists(ros_edges, max_size=8), st.integers(0, 20), st.booleans())
def test_nothing_is_lost_when_a_capture_comes_in_two(edges: list[Edge], at: int, fold: bool) -> None:
    seen = [one for edge in edges for part in unfolded(edge) for one in on_dds(part, ardent=False)]
    first = interpret(Graph.of(seen[:at]), fold=fold)
    second = Graph.of(seen[at:])
    whole = interpret(Graph.of((*first.edges, *second.edges)), fold=fold)
    assert whole == interpret(Graph.of(seen), fold=fold)
    assert interpret(whole, fold=fold) == whole


def test_half_a_service_stays_what_it_is() -> None:
    half = Edge("/s", "publish", topic("rq/addRequest"))
    assert interpret(Graph.of([half]), fold=True).edges == (half,)


def test_half_a_service_of_one_who_has_the_whole_is_no_more() -> None:
    whole = Edge("/s", "ros_call", Object("ros_service", "/add"))
    half = Edge("/s", "publish", topic("rq/addRequest"))
    assert interpret(Graph.of([whole, half]), fold=True).edges == (whole,)


def test_an_incomplete_action_stays_services_and_topics() -> None:
    parts = unfolded(Edge("/s", "ros_request", Object("ros_action", "/go")))
    graph = Graph.of(parts[:-1])
    assert interpret(graph, fold=True) == graph


def test_the_type_of_an_action_is_that_of_its_goal() -> None:
    action = Edge("/s", "ros_operate", Object("ros_action", "/go"))
    goal = Object("ros_service", "/go/_action/send_goal")
    graph = Graph.of(unfolded(action), types=[(goal, "example_interfaces/action/Fibonacci_SendGoal")])
    assert interpret(graph, fold=True) == Graph.of(
        [action], types=[(action.object, "example_interfaces/action/Fibonacci")]
    )
