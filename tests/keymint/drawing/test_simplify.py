# SPDX-License-Identifier: Apache-2.0
"""Reducing a graph to what a picture has room for."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import pytest
from hypothesis import given, strategies as st

from keymint.api.graph import EdgeOutcome
from keymint.drawing import simplify as simplified
from keymint.drawing.captions import subtitle
from keymint.drawing.labelled_graph import Label, LabelledEdge, LabelledGraph
from keymint.drawing.simplify import DrawingOptions, Split, shown_edges, simplify

from .graphs import ALLOWED, DENIED, EXPRESSLY_DENIED, edge, fleet, graphs, labelled

COMMON = LabelledEdge(edge("/a", "ros_publish", "ros_topic", "/rosout"), ALLOWED, common=True)


@pytest.mark.parametrize("transport", [ALLOWED, DENIED])
@pytest.mark.parametrize("policy", [ALLOWED, DENIED])
def test_denied_and_false_edges_are_never_hidden_in_a_mark(policy: Label, transport: Label) -> None:
    found = replace(COMMON, policy=policy, transports=(transport,))
    hidden = not simplify(LabelledGraph.of("t", [found], transports=["x"]), DrawingOptions()).stands
    assert hidden is (policy is ALLOWED and transport is ALLOWED)


@given(st.lists(st.sampled_from([ALLOWED, DENIED, EXPRESSLY_DENIED]), max_size=40), st.integers(1, 20))
def test_explicit_denials_are_always_drawn(said: list[Label], limit: int) -> None:
    edges = [labelled("/a", "ros_publish", f"/t{at}", each) for at, each in enumerate(said)]
    shown = shown_edges(edges, DrawingOptions(limit=limit))
    assert [one for one in edges if one.policy is EXPRESSLY_DENIED] == [
        one for one in shown if one.policy is EXPRESSLY_DENIED
    ]
    if len(edges) > limit:
        assert all(one.policy is not DENIED for one in shown)
        assert len(shown) <= max(limit, said.count(EXPRESSLY_DENIED))
    else:
        assert shown == tuple(edges)


OPTIONS = st.builds(
    DrawingOptions,
    split=st.sampled_from(Split),
    transport=st.sampled_from([None, 0]),
    limit=st.sampled_from([None, 1, 5]),
    fold=st.sampled_from([None, True, False]),
    group=st.sampled_from([None, True, False]),
    common=st.booleans(),
    denials=st.booleans(),
)


@given(st.one_of(graphs(), st.integers(1, 12).map(fleet)), OPTIONS, st.integers(1, 30), st.integers(1, 30))
def test_every_edge_is_drawn_or_stood_for_or_counted(
    graph: LabelledGraph, options: DrawingOptions, lines: int, signs: int
) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(simplified, "MOST_LINES", lines)
        patch.setattr(simplified, "MOST_SIGNS", signs)
        drawn = simplify(graph, replace(options, transport=options.transport if graph.transports else None))
    stood = Counter(one for those in drawn.stands.values() for one in those)
    assert set(stood.values()) <= {1}
    assert stood.keys() <= set(graph.edges)
    assert len(drawn.stands) + drawn.folded + sum(drawn.left_out.values()) == len(graph.edges)
    missing = [one for one in graph.edges if one not in stood]
    marked = [one for one in missing if one.common and not options.common]
    assert sum(drawn.left_out.values()) == len(missing) - len(marked)
    if not marked:
        assert drawn.left_out == Counter((one.outcome(options.transport), one.edge.object.kind) for one in missing)
    for one, those in drawn.stands.items():
        assert {(each.decisions, each.audit, each.outcome()) for each in those} == {
            (one.decisions, one.audit, one.outcome())
        }


def unlike(count: int) -> LabelledGraph:
    """Return a graph of subjects that all differ, since each reads what the next one publishes."""
    edges = [
        each
        for at in range(count)
        for each in (
            labelled(f"/r{at}", "ros_publish", f"/topic{at}", ALLOWED),
            labelled(f"/r{at}", "ros_subscribe", f"/topic{(at + 1) % count}", ALLOWED),
            labelled(f"/r{at}", "ros_call", f"/service{at}", ALLOWED),
        )
    ]
    return LabelledGraph.of("t", edges)


def test_300_subjects_that_differ_are_drawn_as_matrices_with_every_right() -> None:
    graph = unlike(300)
    drawn = simplify(graph, DrawingOptions())
    assert (drawn.matrices, drawn.fold.classes, drawn.left_out) == (True, (), {})
    assert len(drawn.stands) + drawn.folded == 900
    assert sum(map(len, drawn.stands.values())) == 900


def test_what_is_left_out_is_counted_by_kind() -> None:
    graph = unlike(300)
    lines = simplify(graph, DrawingOptions(group=False, fold=False))
    assert (len(lines.stands), dict(lines.left_out)) == (
        600,
        {(EdgeOutcome.ALLOW, "ros_topic"): 200, (EdgeOutcome.ALLOW, "ros_service"): 100},
    )
    assert "NOT DRAWN: 300 of 900 edges: 300 allowed (200 topic, 100 service)" in subtitle(lines)
    assert sum(simplify(graph, DrawingOptions(limit=10)).left_out.values()) == 890


PARTS = ("describe_parameters", "get_parameters", "get_parameter_types", "list_parameters")


def test_parameters_are_drawn_once() -> None:
    calls = [labelled("/a", "ros_call", f"/b/{part}", ALLOWED) for part in PARTS]
    read = labelled("/a", "ros_read", "/b", ALLOWED)
    drawn = simplify(LabelledGraph.of("t", [*calls, read]), DrawingOptions())
    assert list(drawn.stands) == [read]
    assert sorted(one.edge for one in drawn.stands[read]) == sorted(one.edge for one in (*calls, read))
    assert drawn.folded == 4
    # Parts of which one is decided otherwise, and parts of what is not allowed as a whole, stay.
    odd = replace(calls[0], audit=True)
    assert set(simplify(LabelledGraph.of("t", [odd, *calls[1:], read]), DrawingOptions()).stands) == {odd, read}
    denied = replace(read, policy=DENIED)
    assert len(simplify(LabelledGraph.of("t", [*calls, denied]), DrawingOptions()).stands) == 5


def test_denials_without_a_rule_may_be_counted_alone() -> None:
    denied = [labelled("/a", "ros_publish", f"/t{at}", DENIED) for at in range(700)]
    graph = LabelledGraph.of("t", [*denied, labelled("/a", "ros_subscribe", "/t1", ALLOWED)])
    drawn = simplify(graph, DrawingOptions(denials=False))
    assert (len(drawn.stands), dict(drawn.left_out)) == (1, {(EdgeOutcome.DENY, "ros_topic"): 700})
    assert not simplify(graph, DrawingOptions(fold=False)).left_out
