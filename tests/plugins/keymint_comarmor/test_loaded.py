# SPDX-License-Identifier: Apache-2.0
"""Policies of the language as loaded policies: the same answers in each form of question."""

from __future__ import annotations

from pathlib import Path

import pytest
from keymint_comarmor.loaded import ComArmorPolicy

import comarmor
from keymint.api import (
    LoadedPolicy,
)
from keymint.api.graph import Edge, Object

POLICY = """<profiles><profile name="all" modifier="AUDIT"><attachment>/r/*</attachment>
<ros_topic qualifier="ALLOW"><attachment>/x*</attachment><permissions><ros_publish/></permissions></ros_topic></profile>
<profile name="a"><attachment>/r/a</attachment>
<ros_topic qualifier="DENY"><attachment>/xy</attachment><permissions><ros_publish/></permissions></ros_topic></profile>
<profile name="b"><attachment>/b</attachment>
<ros_topic qualifier="ALLOW"><attachment>/z</attachment><permissions><ros_publish/></permissions></ros_topic></profile>
</profiles>"""
NAMES = ("/x", "/xy", "/z")


@pytest.fixture
def policy(tmp_path: Path) -> ComArmorPolicy:
    (tmp_path / "policy.xml").write_text(POLICY)
    return ComArmorPolicy(comarmor.load(tmp_path / "policy.xml"))


def decided(policy: LoadedPolicy, subject: str) -> list[bool]:
    edges = (Edge(subject, "ros_publish", Object("ros_topic", name)) for name in NAMES)
    return [policy.decide(edge).allowed for edge in edges]


def test_decisions_one_at_a_time_and_many_at_once(policy: ComArmorPolicy) -> None:
    for subject, expected in {"/r/a": [1, 0, 0], "/r/b": [1, 1, 0], "/b": [0, 0, 1], "/c": [0, 0, 0]}.items():
        assert decided(policy, subject) == list(policy.allowed(subject, "ros_topic", "ros_publish", NAMES)) == expected


def test_the_deciding_rule_says_where_and_whether_to_log(policy: ComArmorPolicy) -> None:
    decision = policy.decide(Edge("/r/a", "ros_publish", Object("ros_topic", "/x")))
    assert decision.where
    assert (decision.where.line, decision.audit) == (2, True)


def test_subjects_profiles_and_rules(policy: ComArmorPolicy) -> None:
    assert policy.subjects() == ("/b", "/r/a")
    assert [each.name for each in policy.profiles("/r/a")] == ["all", "a"]
    assert policy.rules("/c") is None
    assert policy.rules_digest("/c") is None
    assert policy.rules_digest("/r/a") != policy.rules_digest("/r/b")
