# SPDX-License-Identifier: Apache-2.0
"""The layout of graphs."""

from __future__ import annotations

import itertools

from hypothesis import given, strategies as st

from keymint.drawing.appearance import columns
from keymint.drawing.labelled_graph import LabelledGraph
from keymint.drawing.layout import CHARACTER, GAP, PORT_DISTANCE, NodeBox, lay_out

from .graphs import ALLOWED, graphs, labelled, names


def overlap(one: NodeBox, other: NodeBox) -> bool:
    return (
        one.x < other.x + other.width
        and other.x < one.x + one.width
        and one.y < other.y + other.height + GAP - 0.01
        and other.y < one.y + one.height + GAP - 0.01
    )


@given(graphs())
def test_nothing_overlaps_and_labels_fit(graph: LabelledGraph) -> None:
    panel = lay_out(graph.edges, graph.subjects, names(graph.edges, graph.subjects), {})
    assert not [pair for pair in itertools.combinations(panel.boxes, 2) if overlap(*pair)]
    for box in panel.boxes:
        assert columns(box.label) * CHARACTER < box.width
        assert box.x >= 0
        assert box.y >= 0
        assert box.x + box.width <= panel.width + 0.01
        assert box.y + box.height <= panel.height + 0.01


@given(graphs())
def test_every_edge_ends_at_ports_of_its_own_in_its_boxes(graph: LabelledGraph) -> None:
    panel = lay_out(graph.edges, graph.subjects, names(graph.edges, graph.subjects), {})
    boxes = {box.key: box for box in panel.boxes}
    ends: dict[tuple[float, float], int] = {}
    for line in panel.lines:
        edge = line.labelled.edge
        subject, found = boxes[edge.subject], boxes[edge.domain, edge.object]
        assert line.x1 in {subject.x, subject.x + subject.width}
        assert line.x2 in {found.x, found.x + found.width}
        assert subject.y < line.y1 < subject.y + subject.height
        assert found.y < line.y2 < found.y + found.height
        for end in ((line.x1, line.y1), (line.x2, line.y2)):
            ends[end] = ends.get(end, 0) + 1
    assert len(panel.lines) == len(graph.edges)
    assert set(ends.values()) <= {1}


@given(graphs())
def test_the_same_graph_is_the_same_picture(graph: LabelledGraph) -> None:
    again = LabelledGraph.of("t", reversed(graph.edges), graph.subjects, graph.transports)
    called = names(graph.edges, graph.subjects)
    first = lay_out(graph.edges, graph.subjects, called, {})
    assert first == lay_out(again.edges, again.subjects, called, {})


def test_two_subjects_stand_on_both_sides() -> None:
    edges = [labelled(name, "ros_publish", "/chatter", ALLOWED) for name in ("/a", "/b")]
    first, middle, second = sorted(
        lay_out(edges, ["/a", "/b"], names(edges, ["/a", "/b"]), {}).boxes, key=lambda box: box.x
    )
    assert [first.key, second.key] == ["/a", "/b"]
    assert middle.kind == "ros_topic"


def test_what_many_share_stands_apart() -> None:
    subjects = [f"/n{at}" for at in range(6)]
    edges = [
        labelled(name, "ros_publish", topic, ALLOWED) for name in subjects for topic in ("/rosout", f"{name}/odom")
    ]
    boxes = {box.label: box for box in lay_out(edges, subjects, names(edges, subjects), {}).boxes}
    assert boxes["/rosout"].x < boxes["/n0"].x < boxes["/n0/odom"].x


@given(st.permutations(range(6)))
def test_a_graph_that_can_be_drawn_without_crossings_is(order: list[int]) -> None:
    edges = [labelled(f"/s{at}", "ros_publish", f"/o{order[at]}", ALLOWED) for at in range(6)]
    subjects = [f"/s{at}" for at in range(6)]
    panel = lay_out(edges, subjects, names(edges, subjects), {})
    ends = sorted((line.y1, line.y2) for line in panel.lines)
    assert [end for _, end in ends] == sorted(end for _, end in ends)


def test_ports_are_far_enough_from_each_other() -> None:
    edges = [labelled("/a", "ros_publish", f"/o{at}", ALLOWED) for at in range(20)]
    lines = lay_out(edges, ["/a"], names(edges, ["/a"]), {}).lines
    starts = sorted(line.y1 for line in lines)
    assert min(after - before for before, after in itertools.pairwise(starts)) > PORT_DISTANCE - 0.01
