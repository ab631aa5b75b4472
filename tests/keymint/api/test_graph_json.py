# SPDX-License-Identifier: Apache-2.0
"""Graphs as JSON: what is written is read, what is read strictly, and errors say where."""

from __future__ import annotations

import json

import jsonschema
import pytest
from hypothesis import given, settings, strategies as st

from comarmor.rules import KIND_OF
from keymint.api.graph import Edge, Graph, Object
from keymint.api.graph_json import dump, legal_node, legal_subject, load, merge
from keymint.errors import KeymintError
from tests.conftest import CHECKOUT
from tests.effort import tries

SCHEMA = json.loads((CHECKOUT / "schemas/keymint/graph.schema.json").read_text())

segments = st.from_regex(r"[A-Za-z_][A-Za-z0-9_]{0,5}", fullmatch=True)
subjects = st.lists(segments, min_size=1, max_size=3).map(lambda parts: "/" + "/".join(parts))
texts = st.text(st.characters(exclude_categories=["Cs", "Cc"], exclude_characters="￾￿"), min_size=1, max_size=8)
topics = st.builds(
    lambda name, partitions: Object("topic", name, () if partitions == {""} else tuple(sorted(partitions))),
    texts,
    st.sets(st.just("") | texts, max_size=3),
)
ros_objects = st.builds(
    Object, st.sampled_from(["ros_topic", "ros_service", "ros_action", "ros_parameter"]), texts.map("/{}".format)
)


@st.composite
def edges(draw: st.DrawFn) -> Edge:
    found = draw(topics | ros_objects)
    permission = draw(st.sampled_from([name for name, kind in KIND_OF.items() if kind == found.kind]))
    return Edge(draw(subjects), permission, found, draw(st.integers(0, 232)))


graphs = st.builds(Graph.of, st.lists(edges()), st.lists(subjects), st.lists(st.tuples(topics | ros_objects, texts)))


@settings(deadline=None, max_examples=tries(20, 40))
@given(graphs)
def test_what_is_written_is_read(graph: Graph) -> None:
    content = dump(graph)
    jsonschema.validate(json.loads(content), SCHEMA)
    assert load(content, "g.json") == graph
    assert dump(load(content, "g.json")) == content


@settings(deadline=None, max_examples=25)
@given(graphs, graphs)
def test_merging_is_a_union(first: Graph, second: Graph) -> None:
    merged = merge(first, second)
    assert set(merged.edges) == {*first.edges, *second.edges}
    assert set(merged.subjects) == {*first.subjects, *second.subjects}
    assert merge(second, first) == merged == merge(merged, first)


def test_the_default_partition_alone_is_none() -> None:
    text = '{"format": "keymint-graph", "version": 1, "edges": [{"subject": "/a", "permission": "publish", '
    graph = load((text + '"object": "t", "partitions": [""]}]}').encode(), "g.json")
    assert graph.edges == (Edge("/a", "publish", Object("topic", "t")),)
    assert graph.subjects == ("/a",)


def document(*edges: object, **members: object) -> bytes:
    return json.dumps({"format": "keymint-graph", "version": 1, "edges": edges, **members}, indent=0).encode()


EDGE = {"subject": "/a", "permission": "ros_publish", "object": "/t"}


@pytest.mark.parametrize(
    ("content", "line", "words"),
    [
        (b"", 1, "not JSON"),
        (b"\xff", 1, "UTF-8"),
        (b'{"format": "keymint-graph",\n "version": }', 2, "not JSON: expecting value"),
        (b"[]", 1, "expected an object"),
        (b"3", 1, "expected an object"),
        (b'{"a": 1, "a": 2}', 0, "'a' appears twice"),
        (b'{"a": NaN}', 0, "NaN"),
        (b"[" * 100_000, 0, "nested too deeply"),
        (b'{"format": "keymint-graph", "version": 1}', 1, "'edges' is missing"),
        (document(EDGE, format="x"), 2, "format: is 'x', expected 'keymint-graph'"),
        (document(EDGE, version=2), 3, "a newer keymint wrote it"),
        (document(EDGE, version=True), 3, "version: is true"),
        (document(EDGE, subject=[]), 11, "did you mean 'subjects'?"),
        (document(EDGE, {**EDGE, "permission": "ros_publsh"}), 12, "did you mean 'ros_publish'?"),
        (document({**EDGE, "permission": 7}), 7, "unknown permission 7"),
        (document({**EDGE, "subject": "a"}), 6, "'a' is not a subject name"),
        (document({**EDGE, "object": ""}), 8, "expected text"),
        (document({**EDGE, "object": "t"}), 8, "does not begin with '/'"),
        (document({**EDGE, "object": "/\x00"}), 8, "contains an illegal character"),
        (document({**EDGE, "object": "/" + "x" * 2000}), 8, "2,001 characters"),
        (document({**EDGE, "domain": 233}), 9, "from 0 to 232"),
        (document({**EDGE, "domain": False}), 9, "is false"),
        (document({**EDGE, "partitions": ["a"]}), 9, "has no partitions"),
        (document({**EDGE, "partitions": "a"}), 9, "expected an array"),
        (document("x"), 5, "edges[0]: is 'x', expected an object"),
        (document(EDGE, types=[{"kind": "ros_topik", "object": "/t", "type": "T"}]), 13, "did you mean 'ros_topic'?"),
        (document(EDGE, subjects={}), 11, "expected an array"),
        (b" " * (17 * 2**20), 0, "bytes allowed"),
    ],
)
def test_what_is_wrong_is_said_with_its_line(content: bytes, line: int, words: str) -> None:
    with pytest.raises(KeymintError) as caught:
        load(content, "g.json")
    (said,) = caught.value.diagnostics
    assert said.where is not None
    assert (said.where.file, said.code) == ("g.json", "graph-invalid")
    assert words in str(said)
    assert said.where.line == line


@settings(deadline=None, max_examples=tries(30, 60))
@given(st.binary(max_size=200) | st.recursive(st.none() | st.integers() | st.text(max_size=5), lambda inner: st.lists(
    inner, max_size=3) | st.dictionaries(st.sampled_from(["format", "version", "edges", "subjects", "subject"]), inner
), max_leaves=8).map(lambda value: json.dumps(value).encode()))  # fmt: skip
def test_anything_else_is_refused_in_words(content: bytes) -> None:
    with pytest.raises(KeymintError) as caught:
        load(content, "g.json")
    assert caught.value.diagnostics[0].where


@pytest.mark.parametrize("name", ["", "//", "a", "/a/", "//a", "/1", "/a-b", "/a\n", "/é"])
def test_what_is_no_subject(name: str) -> None:
    assert not legal_subject(name)
    assert not legal_node(name)


def test_the_root_enclave_is_a_subject_and_no_node() -> None:
    assert legal_subject("/")
    assert not legal_node("/")
