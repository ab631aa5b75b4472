# SPDX-License-Identifier: Apache-2.0
"""Robots that are equal up to the name."""

from __future__ import annotations

import itertools
from collections import Counter
from dataclasses import replace

from hypothesis import given, strategies as st

from keymint.api.graph import Edge, Object
from keymint.drawing.alike import fold_alike
from keymint.drawing.captions import alike_words
from keymint.drawing.labelled_graph import Label, LabelledEdge, LabelledGraph

from .graphs import ALLOWED, DENIED, EXPRESSLY_DENIED, fleet, labelled

ROBOTS = 12


def robots(*more: LabelledEdge, count: int = ROBOTS) -> LabelledGraph:
    """Return a graph of robots that publish to topics of their own, and read one that they share."""
    own = [labelled(f"/r{at}/cam", "ros_publish", f"/r{at}/image", ALLOWED) for at in range(count)]
    shared = [labelled(f"/r{at}/cam", "ros_subscribe", "/estop", ALLOWED) for at in range(count)]
    return LabelledGraph.of("t", [*own, *shared, *more])


def classes(graph: LabelledGraph) -> list[tuple[str, int]]:
    return [(each.like, len(each.names)) for each in fold_alike(graph.edges, graph.subjects).classes]


def test_robots_that_are_equal_up_to_the_name_are_one() -> None:
    graph = robots()
    folded = fold_alike(graph.edges, graph.subjects)
    assert [one.edge.object.name for one in folded.edges] == ["/r0/image", "/estop"]
    assert {len(those) for those in folded.edges.values()} == {ROBOTS}
    assert folded.subjects == {"/r0/cam": tuple(sorted(f"/r{at}/cam" for at in range(ROBOTS)))}
    assert alike_words(folded.classes[0]) == "12 robots like /r0 (/r0, /r1, /r2, /r3, /r4, …)"


def test_a_robot_that_differs_in_anything_stays() -> None:
    for more in (
        labelled("/r3/cam", "ros_publish", "/more", ALLOWED),
        labelled("/r3/cam", "ros_publish", "/estop", EXPRESSLY_DENIED),
        labelled("/fleet/tower", "ros_subscribe", "/r3/image", ALLOWED),
        labelled("/r4/cam", "ros_subscribe", "/fleet/r3_state", ALLOWED),
        labelled("/r3/other", "ros_subscribe", "/r3/image", ALLOWED),
    ):
        graph = robots(more)
        (found,) = fold_alike(graph.edges, graph.subjects).classes
        assert "/r3" not in found.names
        assert len(found.names) >= ROBOTS - 2
    assert alike_words(found) == "11 robots like /r0 (/r0, /r1, /r2, /r4, /r5, …)"


def test_labels_count() -> None:
    said = [EXPRESSLY_DENIED, DENIED, replace(ALLOWED, reason="another")]
    edges = [labelled(f"/r{at}/cam", "ros_publish", "/t", each) for at, each in enumerate([*said, *said])]
    assert sorted(classes(LabelledGraph.of("t", edges))) == [("/r0", 2), ("/r1", 2), ("/r2", 2)]


def test_names_of_robots_are_found_inside_of_names() -> None:
    edges = [labelled(f"/robot_{at}/cam", "ros_publish", f"/fleet/robot_{at}_image", ALLOWED) for at in range(20)]
    assert classes(LabelledGraph.of("t", edges)) == [("/robot_0", 20)]
    raw = [LabelledEdge(Edge(f"/r{at}", "publish", Object("topic", "odd", (f"/r{at}",))), ALLOWED) for at in range(20)]
    assert classes(LabelledGraph.of("t", raw)) == [("/r0", 20)]
    similar = [labelled(f"/r{at}/cam", "ros_publish", f"/r{at}x/image", ALLOWED) for at in range(20)]
    assert classes(LabelledGraph.of("t", similar)) == []


def test_an_edge_to_every_other_robot_is_one_edge() -> None:
    pairs = [
        labelled(f"/r{at}/cam", "ros_subscribe", f"/r{other}/image", ALLOWED)
        for at, other in itertools.permutations(range(5), 2)
    ]
    graph = robots(*pairs, count=5)
    folded = fold_alike(graph.edges, graph.subjects)
    assert {one.edge.object.name: len(those) for one, those in folded.edges.items()} == {
        "/estop": 5,
        "/r0/image": 5,
        "/r1/image": 20,
    }
    assert {object_.name for _, object_ in folded.others} == {"/r1/image"}
    one_less = LabelledGraph.of("t", [one for one in graph.edges if one is not pairs[7]])
    assert ("/r0", 5) not in classes(one_less)


def test_a_ring_is_not_alike() -> None:
    """Each has one neighbour, but two may not be exchanged."""
    ring = [labelled(f"/r{at}/cam", "ros_subscribe", f"/r{(at + 1) % 6}/image", ALLOWED) for at in range(6)]
    assert classes(LabelledGraph.of("t", ring)) == []


def test_sites_of_robots() -> None:
    edges = [
        labelled(f"/site{site}/robot{robot}/cam", "ros_publish", f"/site{site}/robot{robot}/image", ALLOWED)
        for site in range(3)
        for robot in range(4)
    ]
    graph = LabelledGraph.of("t", edges)
    assert len(fold_alike(graph.edges, graph.subjects).edges) == 1
    # Site 5 knows one robot of site 0, so neither the sites nor the robots of site 0 are alike.
    odd = LabelledGraph.of("t", [*edges, labelled("/site2/x", "ros_subscribe", "/site0/robot0/image", ALLOWED)])
    found = {each.like: each.names for each in fold_alike(odd.edges, odd.subjects).classes}
    assert all("/site0/robot0" not in names for names in found.values())


NAMES = ("r0", "r1", "r2", "x")


@given(
    st.lists(
        st.tuples(
            st.sampled_from(NAMES),
            st.sampled_from(NAMES),
            st.sampled_from(["ros_publish", "ros_subscribe"]),
            st.sampled_from([ALLOWED, EXPRESSLY_DENIED]),
        ),
        max_size=30,
        unique_by=lambda drawn: drawn[:3],
    )
)
def test_robots_that_are_drawn_as_one_may_be_exchanged(drawn: list[tuple[str, str, str, Label]]) -> None:
    """Compared with a renaming of its own, and every edge is drawn or stood for."""
    edges = [labelled(f"/{one}/n", permission, f"/{other}/t", said) for one, other, permission, said in drawn]
    graph = LabelledGraph.of("t", edges)
    folded = fold_alike(graph.edges, graph.subjects)
    rights = {(one.edge.subject, one.edge.permission, one.edge.object.name, one.policy) for one in edges}
    for each in folded.classes:
        for one, other in itertools.combinations(each.names, 2):

            def renamed(name: str, one: str = one, other: str = other) -> str:
                begin = name[: name.index("/", 1)] if name.count("/") > 1 else name
                return {one: other, other: one}.get(begin, begin) + name.removeprefix(begin)

            assert {(renamed(subject), p, renamed(name), said) for subject, p, name, said in rights} == rights
    assert Counter(one for those in folded.edges.values() for one in those) == Counter(graph.edges)
    assert sorted(name for names in folded.subjects.values() for name in names) == list(graph.subjects)


def test_a_fleet_with_one_denial() -> None:
    assert classes(fleet(10)) == [("/robot0/node1", 39)]
