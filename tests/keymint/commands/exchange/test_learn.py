# SPDX-License-Identifier: Apache-2.0
"""``keymint learn``: files, and what stands in the way."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

import comarmor
from keymint.api.graph import Edge, Graph, Object
from keymint.api.graph_json import dump


def does(subject: str, permission: str, name: str) -> Edge:
    kind = "ros_service" if permission in ("ros_call", "ros_execute") else "ros_topic"
    return Edge(subject, permission, Object(kind, name))


SERVED = ("describe_parameters", "get_parameters", "get_parameter_types", "list_parameters", "set_parameters")
NODES = [
    edge
    for subject in ("/robot1/talker", "/robot1/listener")
    for edge in (
        *(does(subject, "ros_execute", f"{subject}/{name}") for name in SERVED),
        does(subject, "ros_publish", "/rosout"),
        does(subject, "ros_subscribe", "/clock"),
    )
]
GRAPH = Graph.of(
    [
        *NODES,
        does("/robot1/talker", "ros_publish", "/robot1/chatter"),
        does("/robot1/listener", "ros_subscribe", "/robot1/chatter"),
    ]
)


@pytest.fixture(autouse=True)
def graph(tmp_path: Path) -> None:
    (tmp_path / "g.json").write_bytes(dump(GRAPH))


def test_to_standard_output_it_is_one_document(keymint, tmp_path: Path) -> None:
    outcome = keymint("learn", "g.json")
    (tmp_path / "p.xml").write_text(outcome.out)
    policy = comarmor.load(tmp_path / "p.xml")
    assert (outcome.code, outcome.err) == (0, "")
    assert policy.subjects() == GRAPH.subjects
    assert "include" not in outcome.out


def test_to_a_file_that_includes_what_is_common(keymint, tmp_path: Path) -> None:
    outcome = keymint("learn", "g.json", "-o", "policy.xml")
    assert outcome.out == "policy.d/common_1.xml written\npolicy.xml written\n"
    policy = comarmor.load(tmp_path / "policy.xml")
    for edge in GRAPH.edges:
        assert policy.decide(edge.subject, edge.object.kind, edge.permission, edge.object.name).allowed
    assert not policy.decide("/robot1/listener", "ros_topic", "ros_publish", "/robot1/chatter").allowed
    assert "policy.xml is up to date" in keymint("learn", "g.json", "-o", "policy.xml").out


def test_the_policy_provisions(keymint, tmp_path: Path) -> None:
    keymint("learn", "g.json", "-o", "policy.xml")
    outcome = keymint("provision", "policy.xml", "-w", "ws")
    assert (outcome.code, outcome.err) == (0, "")
    assert (tmp_path / "ws/install/enclaves/robot1/talker/permissions.p7s").exists()


def test_another_policy_is_not_replaced_unless_forced(keymint, tmp_path: Path) -> None:
    (tmp_path / "policy.xml").write_text("<profiles/>")
    outcome = keymint("learn", "g.json", "-o", "policy.xml")
    assert (outcome.code, "exists and differs" in outcome.err) == (1, True)
    assert (tmp_path / "policy.xml").read_text() == "<profiles/>"
    assert keymint("learn", "g.json", "-o", "policy.xml", "--force").code == 0
    assert "/clock" in (tmp_path / "policy.d/common_1.xml").read_text()


def test_dry_run_writes_nothing(keymint, tmp_path: Path) -> None:
    assert "policy.xml would be written" in keymint("learn", "g.json", "-o", "policy.xml", "--dry-run").out
    assert [path.name for path in tmp_path.iterdir()] == ["g.json"]


def test_beside_an_existing_policy(keymint, tmp_path: Path) -> None:
    (tmp_path / "p").mkdir()
    (tmp_path / "p/own.xml").write_text(
        '<profile name="t" xmlns:xi="http://www.w3.org/2001/XInclude"><attachment>/robot1/*</attachment>'
        '<xi:include href="common/node.xml" parse="xml"/>'
        '<ros_topic qualifier="ALLOW"><attachment>/old</attachment><permissions><ros_publish/></permissions>'
        "</ros_topic></profile>"
    )
    outcome = keymint("learn", "g.json", "--policy", "p", "-o", "p/learned.xml")
    lines = outcome.out.splitlines()
    assert [line for line in lines if line.startswith("missing")] == [
        "missing  /robot1/listener ros_subscribe /robot1/chatter",
        "missing  /robot1/talker ros_publish /robot1/chatter",
    ]
    assert "unused   p/own.xml:1: no subject in the graph uses this rule (ros_publish)" in lines
    assert keymint("provision", "p", "-w", "ws").code == 0
    again = keymint("learn", "g.json", "--policy", "p", "-o", "p/learned2.xml", "--json").document["result"]
    assert (again["missing"], again["file"], again["written"]) == ([], None, [])
    assert any("own.xml:1" in found["place"] for found in again["unused"])
    refused = keymint("learn", "g.json", "--policy", "p", "-o", "p/own.xml")
    assert (refused.code, "part of the existing policy" in refused.err) == (1, True)


def test_a_deny_rule_in_the_way_is_a_finding(keymint, tmp_path: Path) -> None:
    (tmp_path / "own.xml").write_text(
        '<profile name="t"><attachment>/robot1/*</attachment>\n<ros_topic qualifier="DENY">'
        "<attachment>*/chatter</attachment><permissions><ros_publish/></permissions></ros_topic></profile>"
    )
    outcome = keymint("learn", "g.json", "--policy", "own.xml", "-o", "add.xml")
    assert outcome.code == 3
    assert "own.xml:2: warning: this rule denies /robot1/talker the ros_publish on '/robot1/chatter'" in outcome.err
    assert (tmp_path / "add.xml").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["missing.json"], "missing.json: error: no such file"),
        (["junk.json"], "junk.json:1: error: not JSON"),
        (["g.json", "--policy", "missing.xml"], "does not exist"),
        (["g.json", "--policy", "junk.json"], "junk.json"),
        (["g.json", "--distro", "jazy", "--policy", "p.xml"], "did you mean 'jazzy'?"),
    ],
)
def test_what_is_refused(keymint, tmp_path: Path, arguments: list[str], words: str) -> None:
    (tmp_path / "junk.json").write_text("junk")
    (tmp_path / "p.xml").write_text("<profiles/>")
    outcome = keymint("learn", *arguments)
    assert outcome.code == (2 if "--distro" in arguments else 1)
    assert words in outcome.err


@pytest.mark.parametrize(
    ("domains", "expected"),
    [([0], ""), ([42], "'keymint provision p.xml --domain 42'"), ([0, 42], "has domains 0, 42")],
)
def test_the_domain_of_a_graph_is_not_forgotten(keymint, tmp_path: Path, domains: list[int], expected: str) -> None:
    edges = [replace(edge, domain=domain) for edge in GRAPH.edges for domain in domains]
    (tmp_path / "g.json").write_bytes(dump(Graph.of(edges)))
    outcome = keymint("learn", "g.json", "-o", "p.xml", "--json")
    report = json.loads(outcome.out)
    said = [each for each in report["diagnostics"] if each["code"] == "learn-domain"]
    assert report["result"]["domains"] == domains
    assert [expected.strip("'") in each["message"] + each["help"] for each in said] == [True] * bool(expected)
    assert ("DDS domain" in (tmp_path / "p.xml").read_text()) == bool(expected)
    assert comarmor.load(tmp_path / "p.xml").subjects() == GRAPH.subjects


def listening(address: str, driver: str) -> Graph:
    """Return what a controller with a listener of tf2 does in one start: its helper node has a new name."""
    return Graph.of(
        [
            *NODES,
            does("/robot1/talker", "ros_execute", f"/transform_listener_impl_{address}/get_type_description"),
            does("/robot1/talker", "ros_execute", f"/robot1/transform_listener_impl_{address}/get_type_description"),
            does("/robot1/talker", "ros_publish", f"/driver_{driver}/status"),
            does("/robot1/talker", "ros_publish", f"/arm_{driver[0]}"),
        ]
    )


def test_a_policy_learned_from_one_start_holds_for_the_next(keymint, tmp_path: Path) -> None:
    (tmp_path / "one.json").write_bytes(dump(listening("5581f0a3b2c0", "8812")))
    outcome = keymint("learn", "one.json", "-o", "policy.xml")
    assert outcome.code == 0
    helper = "/transform_listener_impl_{}/get_type_description"
    assert [line.split(": ")[:2] for line in outcome.err.splitlines()] == [
        ["note", f"{namespace}{helper.format('*')} stands for {namespace}{helper.format('5581f0a3b2c0')}"]
        for namespace in ("/robot1", "")
    ]
    policy = comarmor.load(tmp_path / "policy.xml")
    for edge in listening("7f00aa12e9d0", "8812").edges:
        assert policy.decide(edge.subject, edge.object.kind, edge.permission, edge.object.name).allowed, edge
    for name in ("/transform_listener_impl_1/get_parameters", "/other/transform_listener_impl_1/get_type_description"):
        assert not policy.decide("/robot1/talker", "ros_service", "ros_execute", name).allowed
    assert not policy.decide("/robot1/talker", "ros_topic", "ros_publish", "/driver_9120/status").allowed
    (tmp_path / "two.json").write_bytes(dump(listening("7f00aa12e9d0", "8812")))
    again = keymint("learn", "two.json", "--policy", "policy.xml", "--json").document["result"]
    assert again["missing"] == []


def test_names_that_two_records_have_in_different_forms_are_suggested(keymint, tmp_path: Path) -> None:
    for name, graph in (("one", listening("55", "8812")), ("two", listening("7f", "9120"))):
        (tmp_path / f"{name}.json").write_bytes(dump(graph))
    outcome = keymint("learn", "one.json", "two.json", "-o", "policy.xml", "--json")
    notes = [each for each in outcome.document["diagnostics"] if each["code"] == "names-differ"]
    assert [each["message"].split(":")[0] for each in notes] == [
        "/arm_8 in one record, /arm_9 in another",
        "/driver_8812/status in one record, /driver_9120/status in another",
    ]
    patterns = ("/arm_*", "/driver_*/status")
    assert [each["help"] for each in notes] == [f"then write {each} in the policy" for each in patterns]
    policy = comarmor.load(tmp_path / "policy.xml")
    allowed = [n for n in range(10) if policy.decide("/robot1/talker", "ros_topic", "ros_publish", f"/arm_{n}").allowed]
    assert allowed == [8, 9]
    text = (tmp_path / "policy.xml").read_text()
    assert (text.count("/transform_listener_impl_"), text.count("{namespace}transform_listener_impl_")) == (2, 0)


def test_a_subject_named_after_a_process_is_noted(keymint, tmp_path: Path) -> None:
    (tmp_path / "cli.json").write_bytes(dump(Graph.of([does("/_ros2cli_4711", "ros_subscribe", "/chatter")])))
    outcome = keymint("learn", "cli.json", "-o", "policy.xml")
    assert "note: the name of /_ros2cli_4711 changes with each start" in outcome.err
    assert "<attachment>/_ros2cli_4711</attachment>" in (tmp_path / "policy.xml").read_text()
