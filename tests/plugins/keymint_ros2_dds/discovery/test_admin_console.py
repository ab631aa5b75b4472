# SPDX-License-Identifier: Apache-2.0
"""Captures of RTI Admin Console."""

from __future__ import annotations

import pytest
from keymint_ros2_dds.discovery import graph_source

from keymint.api.graph import Edge, Graph, Object, complete
from keymint.errors import KeymintError
from tests.plugins.keymint_ros2_dds.discovery.admin_console_file import (
    TALKER_GUID,
    TALKER_KEY,
    endpoint,
    participant,
    system,
)

CHATTER = ("publish", "chatter", "std_msgs::msg::dds_::String_", ["rt"])


def test_a_small_one() -> None:
    edges = [CHATTER, ("subscribe", "addRequest", "", ["rq/calc"]), ("publish", "addReply", "", ["rr/calc"])]
    content = system(participant("talker", edges, domain=5), participant("listener", [], "9, 9, 9, 1c1"))
    assert graph_source.recognises(content)
    found = graph_source.read(content, "c.xml", {})
    assert found.graph.edges[0] == Edge("/talker", "publish", Object("topic", "addReply", ("rr/calc",)), 5)
    assert graph_source.interpret(found.graph, fold=True) == Graph.of(
        [
            Edge("/talker", "ros_execute", Object("ros_service", "/calc/add"), 5),
            Edge("/talker", "ros_publish", Object("ros_topic", "/chatter"), 5),
        ],
        ["/listener"],
        [(Object("ros_topic", "/chatter"), "std_msgs/msg/String")],
    )
    assert any(TALKER_GUID in said.message for said in found.diagnostics)


def test_user_data_is_octets() -> None:
    octets = ", ".join(f"{octet:x}" for octet in b"enclave=/robot1/arm;")
    found = graph_source.read(system(participant("/", [CHATTER], user_data=octets)), "c.xml", {})
    assert found.graph.subjects == ("/robot1/arm",)


def test_the_capture_of_the_paper(reference) -> None:
    """White et al. 2018: 18 edges in G_s, 52 in its completion."""
    content = (reference / "ppac/talker_listener_discovery_data.xml").read_bytes()
    graph = graph_source.interpret(graph_source.read(content, "c.xml", {}).graph, fold=False)
    assert graph.subjects == ("/listener", "/talker")
    assert len(graph.edges) == 18
    assert sorted(found.kind for _, found in graph.objects) == ["ros_service"] * 10 + ["ros_topic"] * 3
    assert sum(1 for _ in complete(graph)) == 52
    own = {edge.object.name for edge in graph.edges if (edge.subject, edge.permission) == ("/talker", "ros_call")}
    assert len(own) == 5
    assert all(name.startswith("/talker/") for name in own)


@pytest.mark.parametrize(
    ("content", "place", "words"),
    [
        (b"<system>", b"<system>", "expected the end of <system>"),
        (b"<a/>", b"<a/>", "expected <system>"),
        (b"<system/>", b"<system/>", "no participant"),
        (b"<!DOCTYPE a [<!ENTITY b 'c'>]><system>&b;</system>", b"<!DOCTYPE", "DOCTYPE"),
        (system(participant("a", [], key="1, 2, 3")), b"<participant_data>", "expected four hexadecimal numbers"),
        (system(participant("a", [], key="1, 2, 3, -1")), b"<participant_data>", "expected four hexadecimal numbers"),
        (system(participant("a", [], domain=233)), b"<participant_data>", "from 0 to 232"),
        pytest.param(
            system(participant("a", [], domain=233)).replace(b"233", b"9" * 5000),
            b"<participant_data>",
            f"domain_id is '{'9' * 60}…', expected",
            id="a domain of 5,000 digits",
        ),
        (system(participant("a", [("publish", "", "", ())])), b"<publication_data>", "no <topic_name>"),
        (
            system(participant("a", []).replace("<publications>", endpoint(CHATTER, "7, 7, 7, 1c1"))
                   .replace("</publications>", "")),
            b"<publication_data>",
            "is not in the file",
        ),
    ],
)  # fmt: skip
def test_what_is_wrong_is_said_with_its_line(content: bytes, place: bytes, words: str) -> None:
    with pytest.raises(KeymintError) as caught:
        graph_source.read(content, "c.xml", {})
    said = caught.value.diagnostics[0]
    assert said.where is not None
    assert words in str(said), said
    line = content[: content.index(place)].count(b"\n") + 1
    assert (said.where.file, said.where.line) == ("c.xml", line), said


def test_an_endpoint_and_its_participant_may_stand_far_apart() -> None:
    content = system(participant("a", [], "9, 9, 9, 1c1"), participant("b", [CHATTER], TALKER_KEY))
    assert [edge.subject for edge in graph_source.read(content, "c.xml", {}).graph.edges] == ["/b"]
