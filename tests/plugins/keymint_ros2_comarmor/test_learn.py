# SPDX-License-Identifier: Apache-2.0
"""Learning: the policy allows what the graph has, nothing else of its completion, in few words."""

from __future__ import annotations

import re
from pathlib import Path
from tempfile import TemporaryDirectory

from hypothesis import given, settings, strategies as st
from keymint_ros2_comarmor import policy_type

import comarmor
from comarmor.errors import Origin
from comarmor.rules import PARTS
from keymint.api import LearnedPolicy, PolicySource
from keymint.api.graph import Edge, Graph, Object, complete
from keymint.api.graph_json import KIND_OF
from tests.effort import tries

SUBJECTS = ("/a", "/b", "/ns/a", "/ns/b", "/ns/a/b")
NAMES = ("/t", "/ns/t", "/a", "/a/get_parameters", "/a/set_parameters", "/ns/a/x", "/ns/b/x", "/a*", "/[a]", "/{name}")
TOPICS = ("rt/t", "rt/*", "a b", "\\", "@{X}")

objects = st.builds(
    Object, st.sampled_from(["ros_topic", "ros_service", "ros_action", "ros_parameter"]), st.sampled_from(NAMES)
) | st.builds(
    lambda name, partitions: Object("topic", name, tuple(sorted(partitions))),
    st.sampled_from(TOPICS),
    st.sets(st.sampled_from(["p", "q", "p*"]), max_size=2),
)


@st.composite
def some_edges(draw: st.DrawFn) -> Edge:
    found = draw(objects)
    permission = draw(st.sampled_from([name for name, kind in KIND_OF.items() if kind == found.kind]))
    return Edge(draw(st.sampled_from(SUBJECTS)), permission, found, draw(st.integers(0, 1)))


graphs = st.builds(Graph.of, st.lists(some_edges(), max_size=25), st.lists(st.sampled_from(SUBJECTS), max_size=2))


def loaded(learned: LearnedPolicy, folder: Path, name: str = "policy.xml") -> comarmor.Policy:
    """Return a learned policy, from files as a user has them."""
    (folder / "policy.d").mkdir(exist_ok=True)
    for fragment, content in learned.fragments.items():
        (folder / "policy.d" / fragment).write_bytes(content)
    (folder / name).write_bytes(learned.document)
    return comarmor.load(folder / name)


def elementary(edge: Edge) -> set[tuple[str, str, str, str, str]]:
    """Return what an edge stands for: parts of a composite, each partition by itself; domains are no matter."""
    found = edge.object
    return {
        (edge.subject, kind, permission, found.name + suffix, partition)
        for kind, permission, suffix in PARTS.get((found.kind, edge.permission), ((found.kind, edge.permission, ""),))
        for partition in found.partitions or ("",)
    }


def allows(policy: comarmor.Policy, edge: Edge) -> bool:
    found = edge.object
    return policy.decide(edge.subject, found.kind, edge.permission, found.name, found.partitions).allowed


@settings(deadline=None, max_examples=tries(40, 80))
@given(graphs, st.booleans())
def test_the_law(graph: Graph, split: bool) -> None:
    """Exactly the edges of the graph, and what they stand for, are allowed."""
    learned = policy_type.learn(graph, None, "policy.d" if split else "")
    if not graph.subjects:
        assert learned.document == b""
        return
    with TemporaryDirectory() as folder:
        policy = loaded(learned, Path(folder))
    stated = set().union(*map(elementary, graph.edges))
    for edge in (*graph.edges, *complete(graph)):
        assert allows(policy, edge) == (elementary(edge) <= stated), edge
    assert policy.subjects() == graph.subjects
    assert learned.missing == graph.edges


@settings(deadline=None, max_examples=tries(20, 40))
@given(graphs)
def test_includes_only_when_they_make_it_shorter(graph: Graph) -> None:
    whole = policy_type.learn(graph, None, "")
    split = policy_type.learn(graph, None, "policy.d")
    size = len(split.document) + sum(map(len, split.fragments.values()))
    assert not whole.fragments
    namespace = len(' xmlns:xi="http://www.w3.org/2001/XInclude"')
    assert size <= len(whole.document) + namespace


@settings(deadline=None, max_examples=tries(20, 40))
@given(graphs)
def test_it_is_canonical(graph: Graph) -> None:
    first = policy_type.learn(graph, None, "")
    again = policy_type.learn(Graph.of(reversed(graph.edges), graph.subjects), None, "")
    assert first == again
    if graph.subjects:
        with TemporaryDirectory() as folder:
            # A comment on domains is all that may stand beside the canonical form.
            written = re.sub(rb"<!-- Learned in DDS domain .* -->\n", b"", first.document)
            assert comarmor.render(loaded(first, Path(folder))).encode() == written


@settings(deadline=None, max_examples=tries(20, 40))
@given(graphs, graphs)
def test_beside_an_existing_policy_only_what_is_missing(before: Graph, after: Graph) -> None:
    with TemporaryDirectory() as name:
        folder = Path(name)
        first = policy_type.learn(before, None, "")
        (folder / "old.xml").write_bytes(first.document or b"<profiles/>")
        origin = Origin("old.xml")
        existing = policy_type.load([PolicySource("old", folder / "old.xml", origin)], None)
        old = comarmor.load(folder / "old.xml")
        second = policy_type.learn(after, existing, "")
        (folder / "new.xml").write_bytes(second.document or b"<profiles/>")
        both = comarmor.load(folder)
    assert set(second.missing) == {edge for edge in after.edges if not allows(old, edge)}
    assert not second.conflicts
    assert set(after.subjects) <= set(both.subjects())
    stated = set().union(*map(elementary, (*before.edges, *after.edges)))
    for edge in (*after.edges, *complete(after)):
        assert allows(both, edge) == (elementary(edge) <= stated), edge
    # What was learned before is all used by what it was learned from.
    assert not policy_type.learn(before, existing, "").unused


def test_rules_are_folded_over_permissions_and_attachments() -> None:
    edges = [
        Edge("/s", permission, Object("ros_topic", name))
        for permission in ("ros_subscribe", "ros_publish")
        for name in ("/b", "/a")
    ]
    text = policy_type.learn(Graph.of(edges), None, "").document.decode()
    assert text == (
        '<?xml version="1.0" encoding="UTF-8"?>\n<profiles>\n  <profile name="s">\n'
        "    <attachment>/s</attachment>\n"
        '    <ros_topic qualifier="ALLOW">\n'
        "      <attachment>/a</attachment>\n      <attachment>/b</attachment>\n"
        "      <permissions><ros_publish/><ros_subscribe/></permissions>\n"
        "    </ros_topic>\n  </profile>\n</profiles>\n"
    )


def test_what_nodes_do_for_themselves_is_common_to_them() -> None:
    edges = [
        Edge(subject, "ros_execute", Object("ros_service", f"{subject}/{name}"))
        for subject in ("/r1/arm", "/r2/leg")
        for name in ("get_parameters", "set_parameters", "list_parameters", "describe_parameters")
    ]
    learned = policy_type.learn(Graph.of(edges), None, "policy.d")
    assert list(learned.fragments) == ["common_1.xml"]
    assert learned.fragments["common_1.xml"].count(b"{namespace}{name}/") == 4
    assert learned.document.count(b'<xi:include href="policy.d/common_1.xml" parse="xml"/>') == 2
    assert b"ros_service" not in learned.document
