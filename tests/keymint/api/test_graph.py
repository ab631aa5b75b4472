# SPDX-License-Identifier: Apache-2.0
"""Graphs are canonical, and a completion has every permission of every subject on every object."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from comarmor.rules import PERMISSIONS
from keymint.api.graph import LABELLED, ConfusionMatrix, Edge, EdgeOutcome, Graph, Object, complete

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
