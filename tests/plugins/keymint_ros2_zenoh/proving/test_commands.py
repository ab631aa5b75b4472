# SPDX-License-Identifier: Apache-2.0
"""Proofs of workspaces for Zenoh through the command line."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

POLICY = """<profiles>
  <profile name="sender"><attachments><attachment>/sender</attachment></attachments>
    <ros_topic qualifier="ALLOW"><attachment>{allowed}</attachment><permissions><ros_publish/></permissions></ros_topic>
    <ros_topic qualifier="DENY"><attachment>/r/stop</attachment><permissions><ros_publish/></permissions></ros_topic>
  </profile>
  <profile name="receiver"><attachments><attachment>/receiver</attachment></attachments>
    <ros_topic qualifier="ALLOW"><attachment>/r/*</attachment><permissions><ros_subscribe/></permissions></ros_topic>
  </profile>
</profiles>
"""


@pytest.fixture
def provision(keymint: Callable, tmp_path: Path) -> Callable:
    """Return a function that provisions a workspace with what the sender may publish, and options."""

    def run(allowed: str, *options: str):
        policy = tmp_path / "policy.xml"
        policy.write_text(POLICY.format(allowed=allowed))
        return keymint("provision", policy, *options, "-w", tmp_path / "ws")

    return run


def test_what_gets_around_a_denial_is_an_exception_that_strict_refuses(
    keymint: Callable, provision: Callable, tmp_path: Path
) -> None:
    refused = provision("/r/*", "--transport", "zenoh", "--strict")
    assert refused.code == 3
    assert "not part of the proof: a put of /sender to 0/r/$*stop/*/* reaches /receiver" in refused.err
    assert not (tmp_path / "ws/install").exists()

    warned = provision("/r/*", "--transport", "zenoh")
    assert warned.code == 0
    assert "this DENY ros_topic rule holds for names only" in warned.err

    accepted = keymint("prove", "-w", tmp_path / "ws")
    assert accepted.code == 0
    assert "not part of the proof: all subjects, a put of /sender" in accepted.out
    assert keymint("prove", "--strict", "-w", tmp_path / "ws").code == 3


def test_without_wildcards_there_is_no_exception(keymint: Callable, provision: Callable, tmp_path: Path) -> None:
    assert provision("/r/go", "--transport", "zenoh", "--strict").code == 0
    proven = keymint("prove", "--strict", "-w", tmp_path / "ws")
    assert proven.code == 0
    assert "not part of the proof" not in proven.out


def test_a_router_file_that_was_signed_for_an_earlier_policy(
    keymint: Callable, provision: Callable, tmp_path: Path
) -> None:
    assert provision("/r/go", "--transport", "zenoh").code == 0
    installed, earlier = tmp_path / "ws/install/zenoh", tmp_path / "earlier"
    shutil.copytree(installed, earlier)
    assert provision("/r/halt").code == 0
    shutil.copytree(earlier, installed, dirs_exist_ok=True)
    refuted = keymint("prove", "-w", tmp_path / "ws")
    assert refuted.code == 3
    assert "/sender: the document permits it to put in '0/r/go/a/a' (the ROS topic /r/go)" in refuted.err
    assert "install/zenoh/router.json5:" in refuted.err


def test_both_transports_are_proven(keymint: Callable, provision: Callable, tmp_path: Path) -> None:
    assert provision("/r/go", "--transport", "zenoh", "--transport", "dds").code == 0
    proven = keymint("prove", "-w", tmp_path / "ws")
    assert proven.code == 0
    assert "zenoh-1, omg" in proven.out
