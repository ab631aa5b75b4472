"""A workspace to run verbs in."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

POLICY = """<profiles xmlns:xi="http://www.w3.org/2001/XInclude">
  <profile name="talker">
    <attachment>/talker</attachment>
    <xi:include href="common/node.xml" parse="xml"/>
    <ros_topic qualifier="ALLOW">
      <attachment>/chatter</attachment>
      <permissions><ros_publish/></permissions>
    </ros_topic>
  </profile>
  <profile name="listener">
    <attachment>/robot1/listener</attachment>
    <ros_topic qualifier="ALLOW">
      <attachment>/chatter</attachment>
      <permissions><ros_subscribe/></permissions>
    </ros_topic>
  </profile>
</profiles>
"""


@pytest.fixture
def policy(tmp_path: Path) -> Path:
    """A policy of one file beside the workspace."""
    path = tmp_path / "policy.xml"
    path.write_text(POLICY)
    return path


@pytest.fixture
def provisioned(keymint: Callable, policy: Path, tmp_path: Path) -> Path:
    """A workspace that is provisioned from the policy."""
    outcome = keymint("provision", policy, "-w", "ws")
    assert outcome.code == 0, outcome.err
    return tmp_path / "ws"
