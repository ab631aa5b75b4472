# SPDX-License-Identifier: Apache-2.0
"""Reducing a graph to what a picture has room for."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from keymint.drawing.labelled_graph import Label, LabelledEdge, LabelledGraph
from keymint.drawing.simplify import DrawingOptions, shown_edges, simplify

from .graphs import ALLOWED, DENIED, EXPRESSLY_DENIED, edge, labelled

COMMON = LabelledEdge(edge("/a", "ros_publish", "ros_topic", "/rosout"), ALLOWED, common=True)


@pytest.mark.parametrize("transport", [ALLOWED, DENIED])
@pytest.mark.parametrize("policy", [ALLOWED, DENIED])
def test_denied_and_false_edges_are_never_hidden_in_a_mark(policy: Label, transport: Label) -> None:
    found = replace(COMMON, policy=policy, transports=(transport,))
    hidden = not simplify(LabelledGraph.of("t", [found], transports=["x"]), DrawingOptions()).edges
    assert hidden is (policy is ALLOWED and transport is ALLOWED)


def test_groups_have_the_deepest_readable_level() -> None:
    names = [f"/site{site}/robot{robot}/{node}" for site in range(4) for robot in range(20) for node in "ab"]
    graph = LabelledGraph.of("t", [labelled(name, "ros_publish", "/t", ALLOWED) for name in names])
    assert list(simplify(graph, DrawingOptions()).groups) == [f"/site{at}/… (40 subjects)" for at in range(4)]


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
