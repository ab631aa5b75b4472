# SPDX-License-Identifier: Apache-2.0
"""An existing policy is compared with a graph: edges that it denies, and permissions that no edge uses."""

from __future__ import annotations

from pathlib import Path

import pytest
from keymint_ros2_comarmor import policy_type

from comarmor.errors import Origin
from keymint.api import PolicySource
from keymint.api.graph import Edge, Graph, Object

EXISTING = """\
<profiles>
  <profile name="s">
    <attachment>/s</attachment>
    <ros_topic qualifier="ALLOW">
      <attachment>/used</attachment>
      <attachment>/idle</attachment>
      <permissions><ros_publish/><ros_subscribe/></permissions>
    </ros_topic>
    <ros_service qualifier="ALLOW">
      <attachment>{namespace}{name}/*</attachment>
      <permissions><ros_execute/></permissions>
    </ros_service>
    <ros_topic qualifier="DENY">
      <attachment>/private*</attachment>
      <permissions><ros_subscribe/></permissions>
    </ros_topic>
  </profile>
  <profile name="gone"><attachment>/gone</attachment></profile>
</profiles>
"""


@pytest.fixture
def review(tmp_path: Path):
    path = tmp_path / "old.xml"
    path.write_text(EXISTING)
    existing = policy_type.load([PolicySource("old", path, Origin("old.xml"))], None)
    return lambda *edges: policy_type.learn(Graph.of(edges), existing, "")


def test_what_is_no_longer_used_is_said_with_its_place(review) -> None:
    learned = review(Edge("/s", "ros_publish", Object("ros_topic", "/used")))
    assert learned.document == b""
    assert [(said.code, said.where.line if said.where else 0) for said in learned.unused] == [
        ("learn-unused-attachment", 6),
        ("learn-unused-permission", 4),
        ("learn-unused-rule", 9),
        ("learn-unused-subject", 0),
    ]


def test_an_edge_that_a_deny_rule_denies_is_no_proposal(review) -> None:
    learned = review(
        Edge("/s", "ros_subscribe", Object("ros_topic", "/private/x")),
        Edge("/s", "ros_subscribe", Object("ros_topic", "/other")),
    )
    (said,) = learned.conflicts
    assert (said.code, said.where.line if said.where else 0) == ("learn-denied", 13)
    assert [edge.object.name for edge in learned.missing] == ["/other"]
    assert b"/private" not in learned.document
    assert b"/other" in learned.document


def test_a_rule_that_is_used_completely_is_not_reported(review) -> None:
    learned = review(
        *(
            Edge("/s", permission, Object("ros_topic", name))
            for permission in ("ros_publish", "ros_subscribe")
            for name in ("/used", "/idle")
        ),
        Edge("/s", "ros_execute", Object("ros_service", "/s/get_parameters")),
        Edge("/gone", "ros_publish", Object("ros_topic", "/x")),
    )
    assert learned.unused == ()


def test_a_composite_edge_uses_the_rules_on_its_parts(review) -> None:
    learned = review(Edge("/s", "ros_operate", Object("ros_action", "/s/do")))
    assert ("learn-unused-rule", 9) not in [
        (note.code, note.where.line if note.where else 0) for note in learned.unused
    ]
    assert ("learn-unused-rule", 4) in [(note.code, note.where.line if note.where else 0) for note in learned.unused]
