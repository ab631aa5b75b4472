# SPDX-License-Identifier: Apache-2.0
"""Hints, read from counts and from graphs; errors are reported with their line."""

from __future__ import annotations

import pytest
from hypothesis import given, strategies as st

from keymint.api import Hint, graph_json
from keymint.api.graph import Edge, Graph, Object
from keymint.command_line.request_counts import load_hints
from keymint.errors import KeymintError

HEAD = "subject,permission,object,count\n"


def refused(text: str | bytes) -> list[str]:
    with pytest.raises(KeymintError) as caught:
        load_hints(text.encode() if isinstance(text, str) else text, "hints.csv")
    return [str(found) for found in caught.value.diagnostics]


def test_counts_of_one_edge_add_up() -> None:
    found = load_hints(
        f"{HEAD}/talker,ros_publish,/b,3\n\n/talker,ros_publish,/a,1\n/talker,ros_publish,/b,4\n".encode(), "h"
    )
    a, b = (Edge("/talker", "ros_publish", Object("ros_topic", name)) for name in ("/a", "/b"))
    assert found == (Hint(a, 1), Hint(b, 7))


def test_columns_may_stand_in_any_order_and_name_partitions() -> None:
    text = 'count,object,partition,permission,subject\r\n2,"a,b",p,subscribe,/cell/arm\r\n'
    (found,) = load_hints(text.encode("utf-8-sig"), "h")
    assert found == Hint(Edge("/cell/arm", "subscribe", Object("topic", "a,b", ("p",))), 2)


@given(st.lists(st.tuples(st.sampled_from(["/a", "/b/c"]), st.sampled_from(["/x", "/y/z"])), max_size=5))
def test_a_graph_counts_every_edge_once(pairs) -> None:
    graph = Graph.of(Edge(subject, "ros_call", Object("ros_service", name)) for subject, name in pairs)
    assert load_hints(graph_json.dump(graph), "g") == tuple(Hint(edge, 1) for edge in graph.edges)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "hints.csv:1: the first line is '', not the names of the columns"),
        ("subject,object\n", "the first line is 'subject,object', not the names of the columns"),
        (f"{HEAD.strip()},colour\n", "not the names of the columns"),
        (f"{HEAD}/talker,ros_publish,/a\n", "hints.csv:2: has 3 fields instead of 4"),
        (f"{HEAD}talker,ros_publish,/a,1\n", "'talker' is not a subject name"),
        (f"{HEAD}/talker,ros_publsh,/a,1\n", "did you mean 'ros_publish'?"),
        (f"{HEAD}/talker,sing,/a,1\n", "there is no permission 'sing'"),
        (f"{HEAD}/talker,ros_publish,,1\n", "the object, or its partition, is empty"),
        (f"{HEAD}/talker,ros_publish,/a,-1\n", "'-1' is not a count"),
        (f"{HEAD}/talker,ros_publish,/a,1.5\n", "'1.5' is not a count"),
        (f"{HEAD}/talker,ros_publish,/a,{10**30}\n", "is not a count"),
        (f"{HEAD.strip()},partition\n/talker,ros_publish,/a,1,p\n", "a ros_topic has no partition"),
        (f'{HEAD}/talker,ros_publish,"/a,1\n', "not CSV"),
        (b"\xff\xfe", "hints.csv:1: the text is not UTF-8"),
        ('{"format": "other"}', "hints.csv"),
    ],
)
def test_what_is_wrong_is_said_with_its_line(text, said) -> None:
    (found,) = refused(text)
    assert said in found


def test_every_line_that_is_wrong_is_said() -> None:
    lines = refused(f"{HEAD}/talker,ros_publish,/a,x\n/talker,ros_publish,/b,1\n/9,ros_publish,/c,1\n")
    assert [line.split(": ")[0] for line in lines] == ["hints.csv:2", "hints.csv:4"]
