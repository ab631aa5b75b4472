# SPDX-License-Identifier: Apache-2.0
"""What rules keep from starting: by each right alone that a node or a client of parameters asks for."""

from __future__ import annotations

from pathlib import Path

import pytest
from keymint_ros.distros import DISTROS, library
from keymint_ros2_dds import build_type

import comarmor
from comarmor.errors import Diagnostic, Origin, Severity
from comarmor.rules import Effect, Rule
from keymint.ir import SubjectRules

NODE, CLIENT = "node-cannot-start", "parameter-client-cannot-start"
ASKED = {
    "publish ros_discovery_info": ("topic", "ros_discovery_info", "publish"),
    "subscribe ros_discovery_info": ("topic", "ros_discovery_info", "subscribe"),
    "publish /rosout": ("ros_topic", "/rosout", "ros_publish"),
    "publish /parameter_events": ("ros_topic", "/parameter_events", "ros_publish"),
    "subscribe /parameter_events (rclcpp)": ("ros_topic", "/parameter_events", "ros_subscribe"),
    "serve any …/get_type_description": ("ros_service", "/any/node/get_type_description", "ros_execute"),
}
"""What a node of Iron and later asks for, in the words of the note, and as kind, object and permission."""
NODE_XML = '<xi:include href="common/node.xml"/>'


def rule(kind: str, name: str, *permissions: str, effect: str = "ALLOW") -> str:
    listed = "".join(f"<{permission}/>" for permission in permissions)
    return f'<{kind} qualifier="{effect}"><attachment>{name}</attachment><permissions>{listed}</permissions></{kind}>'


def notes(folder: Path, *parts: str, distro: str = "jazzy") -> list[Diagnostic]:
    """Return the notes about a subject with some rules."""
    head = '<profile xmlns:xi="http://www.w3.org/2001/XInclude" name="n"><attachment>/ns/n</attachment>\n'
    (folder / "p.xml").write_text("\n".join([head, *parts, "</profile>"]))
    policy = comarmor.load(folder / "p.xml", library=library(distro))
    found = list(build_type.check_node(SubjectRules("/ns/n", policy.rules("/ns/n")), distro))
    assert all((each.severity, each.subject) == (Severity.NOTE, "/ns/n") for each in found)
    return found


def codes(folder: Path, *parts: str, distro: str = "jazzy") -> list[str]:
    return [each.code for each in notes(folder, *parts, distro=distro)]


def test_dds_refuses_what_a_node_creates_and_zenoh_does_not() -> None:
    from keymint_ros2_zenoh import build_type as zenoh

    refused = SubjectRules("/n", ())
    assert [*build_type.check_node(refused, "jazzy")]
    assert [*zenoh.check_node(refused, "jazzy")] == []


@pytest.mark.parametrize("distro", DISTROS)
def test_a_plain_node_starts_with_the_common_file(tmp_path: Path, distro: str) -> None:
    assert codes(tmp_path, NODE_XML, distro=distro) == []


@pytest.mark.parametrize("lacking", ASKED)
def test_each_right_alone(tmp_path: Path, lacking: str) -> None:
    assert notes(tmp_path, *(rule(kind, name, permission) for kind, name, permission in ASKED.values())) == []
    others = (rule(*each) for words, each in ASKED.items() if words != lacking)
    (found,) = notes(tmp_path, *others)
    assert found.code == NODE
    assert found.message == (
        f"a node of this subject cannot start on Jazzy with its default options: it may not {lacking}"
    )


@pytest.mark.parametrize("denied", ASKED)
def test_a_denial_is_as_good_as_a_lack(tmp_path: Path, denied: str) -> None:
    kind, name, permission = ASKED[denied]
    name = "*/get_type_description" if kind == "ros_service" else name
    (found,) = notes(tmp_path, NODE_XML, rule(kind, name, permission, effect="DENY"))
    assert found.message.endswith(f"it may not {denied}")


def test_nothing_at_all_is_one_line(tmp_path: Path) -> None:
    (found,) = notes(tmp_path)
    assert all(words in found.message for words in ASKED)
    assert "common/node.xml" in found.help


@pytest.mark.parametrize(
    ("distro", "needs_types", "is_known"),
    [("eloquent", False, False), ("foxy", False, True), ("humble", False, True), ("iron", True, True),
     ("rolling", True, True)],
)  # fmt: skip
def test_by_distribution(tmp_path: Path, distro: str, needs_types: bool, is_known: bool) -> None:
    sros2 = [rule(*each) for words, each in ASKED.items() if "type" not in words]
    assert codes(tmp_path, *sros2, distro=distro) == [NODE] * needs_types
    assert codes(tmp_path, distro=distro) == [NODE] * is_known


@pytest.mark.parametrize(
    "rules",
    [
        [rule("topic", "*", "publish", "subscribe")],
        [rule("topic", "r[tqr]/*", "publish", "subscribe"), rule("topic", "ros_*", "publish", "subscribe")],
        [
            '<xi:include href="common/node/graph.xml"/>', rule("ros_topic", "/*", "ros_publish", "ros_subscribe"),
            rule("ros_service", "/*_type_*", "ros_execute"),
        ],
    ],
)  # fmt: skip
def test_it_matters_what_rules_mean_and_not_how_they_are_written(tmp_path: Path, rules: list[str]) -> None:
    assert codes(tmp_path, *rules) == []


def test_half_of_the_service_is_not_enough(tmp_path: Path) -> None:
    half = rule("topic", "rq/ns/n/get_type_descriptionRequest", "subscribe")
    plain = [rule(*each) for words, each in ASKED.items() if "type" not in words]
    assert codes(tmp_path, *plain, half) == [NODE]
    assert codes(tmp_path, *plain, half, rule("topic", "rr/ns/x/get_type_descriptionReply", "publish")) == [NODE]
    assert codes(tmp_path, *plain, half, rule("topic", "rr/ns/n/get_type_descriptionReply", "publish")) == []


def test_a_node_that_has_another_name_than_its_subject_is_named_in_the_remedy(tmp_path: Path) -> None:
    """``common/node.xml`` would grant the service of the subject's name; the note would go, and no node would start."""
    plain = [rule(*each) for words, each in ASKED.items() if "type" not in words]
    (found,) = notes(tmp_path, *plain, rule("ros_service", "/demo/x/get_parameters", "ros_execute"))
    assert found.help == (
        "allow ros_execute on /demo/x/get_type_description: common/node.xml has that for a node /ns/n only"
    )
    for own in ("/ns/n/get_parameters", "/*/get_parameters"):
        (found,) = notes(tmp_path, *plain, rule("ros_service", own, "ros_execute"))
        assert found.help.startswith("include common/node.xml")


def test_an_endpoint_in_a_partition_is_another_one(tmp_path: Path) -> None:
    elsewhere = (
        '<topic qualifier="ALLOW"><attachment>ros_discovery_info</attachment>'
        "<permissions><publish/><subscribe/></permissions><partitions><partition>p</partition></partitions></topic>"
    )
    plain = [rule(*each) for words, each in ASKED.items() if "discovery" not in words]
    assert codes(tmp_path, *plain, elsewhere) == [NODE]


READ, WRITE = "ros_read", "ros_write"


@pytest.mark.parametrize(
    ("rules", "server"),
    [
        ([rule("ros_parameter", "/x", READ)], "/x"),
        ([rule("ros_parameter", "/x", READ, WRITE)], None),
        ([rule("ros_parameter", "/x", WRITE)], None),
        ([rule("ros_parameter", "/*", READ), rule("ros_parameter", "/*", WRITE)], None),
        ([rule("ros_parameter", "/[xy]", READ), rule("ros_parameter", "/x", WRITE)], "/y"),
        ([rule("ros_parameter", "/x", READ, WRITE), rule("ros_parameter", "/x", WRITE, effect="DENY")], "/x"),
        ([rule("ros_service", "/x/get_parameters", "ros_call")], None),
        ([rule("ros_service", "/x/*_parameter*", "ros_call")], None),
        (
            [
                rule("ros_service", f"/x/{name}", "ros_call")
                for name in ("get_parameters", "describe_parameters", "get_parameter_types", "list_parameters")
            ],
            "/x",
        ),
    ],
)
def test_a_client_that_may_read_but_not_write(tmp_path: Path, rules: list[str], server: str | None) -> None:
    found = notes(tmp_path, NODE_XML, *rules)
    assert [each.code for each in found] == [CLIENT] * (server is not None)
    if server is not None:
        where = found[0].where
        assert found[0].message.endswith(f"e.g. those of {server}")
        assert where is not None
        assert (where.file, where.line) == (str(tmp_path / "p.xml"), 4)


def test_what_cannot_be_compiled_has_its_own_finding(tmp_path: Path) -> None:
    odd = Rule(Effect.ALLOW, "ros_topic", ("ros_publish",), ("/[[:nope:]]",), (), False, Origin("table.csv", 2))
    assert [*build_type.check_node(SubjectRules("/n", (odd,)), "jazzy")] == []
