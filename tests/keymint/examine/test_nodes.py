# SPDX-License-Identifier: Apache-2.0
"""``check`` notes subjects whose nodes cannot start; of a policy that has none, it remembers that."""

from __future__ import annotations

from pathlib import Path
from unittest import mock

import pytest
from keymint_ros2_dds import DdsSecurity

from keymint.api.plugin_loader import Plugins

RULES = '<ros_topic qualifier="ALLOW"><attachment>/x</attachment><permissions><ros_publish/></permissions></ros_topic>'
NODE = '<xi:include href="common/node.xml" parse="xml"/>'
NOTE = "node-cannot-start"


def policy(inner: str) -> str:
    return (
        '<profiles xmlns:xi="http://www.w3.org/2001/XInclude"><profile name="a"><attachment>/a</attachment>'
        f"{inner}{RULES}</profile></profiles>"
    )


@pytest.fixture
def folder(keymint, tmp_path: Path) -> Path:
    (tmp_path / "policy.xml").write_text(policy(NODE))
    assert keymint("provision", "policy.xml", "-w", "ws").code == 0
    assert keymint("check", "-w", "ws", "--json").codes() == []
    return tmp_path


def asked(keymint, *options: str) -> tuple[int, list[str]]:
    """Return how often subjects were asked about, and the codes."""
    real, calls = DdsSecurity.check_node, []

    def counted(*arguments: object) -> object:
        calls.append(arguments)
        return real(*arguments)

    with mock.patch.object(DdsSecurity, "check_node", staticmethod(counted)):
        outcome = keymint("check", "-w", "ws", "--json", *options)
    assert outcome.code == 0, outcome.out
    return len(calls), outcome.codes()


def test_a_policy_without_notes_is_asked_once(keymint, folder: Path) -> None:
    assert asked(keymint) == (0, [])
    assert asked(keymint, "--fresh") == (1, [])
    assert asked(keymint) == (0, [])


def test_a_changed_policy_is_asked_again(keymint, folder: Path) -> None:
    (folder / "policy.xml").write_text(policy(""))
    assert keymint("provision", "policy.xml", "-w", "ws", "--revoke-superseded").code == 0
    for _ in range(2):  # notes are not remembered
        number, codes = asked(keymint)
        assert (number, NOTE in codes) == (1, True)


def test_another_version_of_a_plugin_is_asked_again(keymint, folder: Path) -> None:
    """Its build type may know more nodes that cannot start."""
    with mock.patch.object(Plugins, "versions", property(lambda _: "another")):
        assert asked(keymint)[0] == 1
