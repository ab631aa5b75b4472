# SPDX-License-Identifier: Apache-2.0
"""Participants with the files of the root enclave, which ``ROS_SECURITY_ENCLAVE_OVERRIDE=/`` gives to all nodes."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from keymint_ros2_dds.vendors.participants import DeniedError, RefusedError, System

from .provisioning import enclave

if TYPE_CHECKING:
    from collections.abc import Callable

RULE = """<ros_topic qualifier="ALLOW"><attachment>/{}</attachment>
      <permissions><ros_publish/><ros_subscribe/></permissions></ros_topic>"""
POLICY = f"""<profiles>
  <profile name="root"><attachment>/</attachment>{RULE.format("chatter")}</profile>
  <profile name="talker"><attachment>/talker</attachment>{RULE.format("chatter")}{RULE.format("secret")}</profile>
</profiles>
"""


def test_it_exchanges_what_it_may_and_has_no_rights_of_others(
    provisioned: Callable[[str], Path], system: System, tmp_path: Path
) -> None:
    install = provisioned(POLICY)
    root = system.open(enclave(install, "/"))
    reader = root.edge("subscribe", "rt/chatter")
    for subject in ("/", "/talker"):
        system.open(enclave(install, subject)).edge("publish", "rt/chatter").write(subject)
        assert reader.read() == subject
    with pytest.raises(DeniedError):
        root.edge("publish", "rt/secret")
    stolen = tmp_path / "enclave"
    shutil.copytree(enclave(install, "/"), stolen, ignore=shutil.ignore_patterns("talker"))
    shutil.copy(enclave(install, "/talker") / "permissions.p7s", stolen)
    with pytest.raises(RefusedError):
        system.open(stolen)
