# SPDX-License-Identifier: Apache-2.0
"""Keystores as the verbs leave them, stage by stage, and whether participants of two stages communicate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from keymint_ros2_dds.vendors.participants import RefusedError

from .probe_commands import MatchedError, await_rejection
from .provisioning import enclave

if TYPE_CHECKING:
    from pathlib import Path

    from keymint_ros2_dds.vendors.participants import System

WAIT = 10.0
"""How many seconds something takes at most."""
POLICY = """<profiles>
  <profile name="talker"><attachment>/talker</attachment>
    <ros_topic qualifier="ALLOW"><attachment>/x</attachment><permissions><ros_publish/></permissions></ros_topic>
    <ros_topic qualifier="ALLOW"><attachment>/wide</attachment><permissions><ros_publish/></permissions></ros_topic>
  </profile>
  <profile name="listener"><attachment>/listener</attachment>
    <ros_topic qualifier="ALLOW"><attachment>/*</attachment><permissions><ros_subscribe/></permissions></ros_topic>
  </profile>
  <profile name="stolen"><attachment>/stolen</attachment>
    <ros_topic qualifier="ALLOW"><attachment>/x</attachment><permissions><ros_publish/></permissions></ros_topic>
  </profile>
</profiles>
"""


@dataclass(frozen=True)
class Stages:
    """The keystore after each step, beside each other."""

    folder: Path
    workspace: Path

    def __call__(self, stage: str, subject: str) -> Path:
        return enclave(self.folder / stage, subject)


def hears(system: System, listener: Path, talker: Path) -> bool:
    """Tell whether a sample arrives; else one end refuses the other, or its own files."""
    try:
        reader = system.open(listener).edge("subscribe", "rt/x")
        system.open(talker).edge("publish", "rt/x").write("hello")
        if await_rejection(reader, WAIT):
            return False
    except RefusedError:
        return False
    except MatchedError:
        pass
    return reader.read(WAIT) == "hello"
