# SPDX-License-Identifier: Apache-2.0
"""A workspace to run verbs in."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from keymint import cli
from keymint.store.store import Store
from tests.conftest import NOW

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
    <attachment>/robot1/listener</attachment><xi:include href="common/node.xml" parse="xml"/>
    <ros_topic qualifier="ALLOW">
      <attachment>/chatter</attachment>
      <permissions><ros_subscribe/></permissions>
    </ros_topic>
  </profile>
</profiles>
"""


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """Where the root of a workspace is to be."""
    return tmp_path / "ws"


@pytest.fixture
def store(root: Path) -> Store:
    """A store of that workspace."""
    return Store({root: False, root / "install": False, root / "private": True}, root / ".keymint")


@pytest.fixture
def policy(tmp_path: Path) -> Path:
    """A policy of one file beside the workspace."""
    path = tmp_path / "policy.xml"
    path.write_text(POLICY)
    return path


@pytest.fixture
def created(keymint: Callable, policy: Path, tmp_path: Path) -> Path:
    """A workspace with source packages that are not built yet."""
    assert keymint("init", "ws", "--policy", policy).code == 0
    assert keymint("create", "--all", "-w", "ws").code == 0
    return tmp_path / "ws"


@pytest.fixture
def provisioned(ws: Path) -> Path:
    """A workspace that is provisioned from the policy; a copy, of which Keymint remembers no file."""
    return ws


@pytest.fixture
def just_provisioned(keymint: Callable, policy: Path, tmp_path: Path) -> Path:
    """A workspace of which Keymint remembers what it wrote."""
    outcome = keymint("provision", policy, "-w", "ws")
    assert outcome.code == 0, outcome.err
    return tmp_path / "ws"


@pytest.fixture(scope="session")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two workspaces of one policy, ``ws`` and ``foreign``: names and dates are the same, keys are not."""
    folder = tmp_path_factory.mktemp("made")
    (folder / "policy.xml").write_text(POLICY)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SOURCE_DATE_EPOCH", str(NOW))
        for name in ("ws", "foreign"):
            assert cli.main(["provision", str(folder / "policy.xml"), "-w", str(folder / name), "-q"]) == 0
    return folder


@pytest.fixture
def ws(made: Path, tmp_path: Path) -> Path:
    """A copy of a provisioned workspace, with its policy beside it."""
    shutil.copy(made / "policy.xml", tmp_path / "policy.xml")
    shutil.copytree(made / "ws", tmp_path / "ws")
    return tmp_path / "ws"
