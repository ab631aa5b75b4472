# SPDX-License-Identifier: Apache-2.0
"""Rules of the shipped library are cited by the name that policies include them by, wherever a person reads it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from comarmor.errors import Origin
from tests.conftest import CHECKOUT

NAME = "common/node/logging.xml:3 (library)"
LIBRARY = str(CHECKOUT / "templates/keymint_ros/comarmor.d")
DENIED = """<profiles xmlns:xi="http://www.w3.org/2001/XInclude">
  <profile name="talker">
    <attachment>/talker</attachment>
    <xi:include href="common/node.xml" parse="xml"/>
    <ros_topic qualifier="ALLOW"><attachment>/rosout</attachment><permissions><ros_publish/></permissions></ros_topic>
    <ros_topic qualifier="DENY"><attachment>/clock</attachment><permissions><ros_subscribe/></permissions></ros_topic>
  </profile>
</profiles>
"""


@pytest.mark.parametrize(
    "arguments",
    [
        ("query", "policy.xml", "what can /talker do"),
        ("query", "policy.xml", "who can publish /rosout"),
        ("query", "policy.xml", "can /talker publish /rosout"),
        ("diff", "none.xml", "policy.xml"),
        ("lint", "denied.xml"),
    ],
    ids=lambda arguments: " ".join(arguments[:3]),
)
def test_every_verb_cites_it(keymint: Callable, policy: Path, tmp_path: Path, arguments: tuple[str, ...]) -> None:
    (tmp_path / "none.xml").write_text("<profiles/>")
    (tmp_path / "denied.xml").write_text(DENIED)
    outcome = keymint(*arguments)
    said = outcome.out + outcome.err
    assert "(library)" in said
    assert LIBRARY not in said
    assert "templates/keymint_ros" not in said


def test_the_reason_of_a_decision_cites_it(tmp_path: Path) -> None:
    import keymint_ros2_comarmor

    from keymint.api import PolicySource
    from keymint.api.graph import Edge, Object

    path = tmp_path / "policy.xml"
    path.write_text(DENIED)
    sources = [PolicySource("policy.xml", path, Origin("policy.xml"))]
    loaded = keymint_ros2_comarmor.policy_type.load(sources, Path(LIBRARY, "iron"))
    decision = loaded.decide(Edge("/talker", "ros_publish", Object("ros_topic", "/parameter_events")))
    assert "common/node/parameter_events.xml:3 (library)" in str(decision.reason)
    assert LIBRARY not in str(decision.reason)


def test_a_new_node_has_one_line_of_the_library(keymint: Callable, policy: Path, tmp_path: Path) -> None:
    (tmp_path / "none.xml").write_text("<profiles/>")
    lines = keymint("diff", "none.xml", policy, "--format", "markdown").out.splitlines()
    talker = lines[lines.index("#### `/talker` (new)") :]
    assert [line for line in talker if line.startswith(("| gains", "…"))] == [
        "| gains | `ros_publish` | `/chatter` | `policy.xml:5` |",
        "… and the 6 rules of `common/node.xml` (library)",
    ]
    # What changes for a node that was there is listed in full.
    (tmp_path / "bare.xml").write_text(
        policy.read_text().replace('<xi:include href="common/node.xml" parse="xml"/>', "")
    )
    lines = keymint("diff", "bare.xml", policy, "--format", "markdown").out.splitlines()
    assert len([line for line in lines if "(library)" in line]) == 2 * 13  # of both nodes
    # As JSON, places are paths.
    document = keymint("diff", "bare.xml", policy, "--json").document
    files = {change["rule"]["file"] for each in document["result"]["subjects"] for change in each["changes"]}
    assert all((tmp_path / file).is_file() for file in files)


def test_a_changed_copy_of_the_library_is_not_folded(keymint: Callable, provisioned: Path, tmp_path: Path) -> None:
    (tmp_path / "none.xml").write_text("<profiles/>")

    def lines() -> list[str]:
        said = keymint("diff", "none.xml", provisioned, "--format", "markdown").out.splitlines()
        return [line for line in said if "ros_publish" in line or line.startswith("…")]

    assert len(lines()) == 3  # what the talker publishes, and the library for both nodes
    (copy,) = provisioned.rglob("common/node/logging.xml")
    copy.write_text(copy.read_text().replace("/rosout", "/*"))
    assert any("/*" in line for line in lines())
