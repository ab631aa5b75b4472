# SPDX-License-Identifier: Apache-2.0
"""Discover and learn what nodes of ROS do; take over what ``ros2 security`` made; ``ros2 keymint``."""

from __future__ import annotations

import json
import os
import shutil
import sys
from pathlib import Path

import pytest
from keymint_ros2_dds.discovery import graph_source

from tests.conftest import CHECKOUT

from .ros_system import GRAPH, SECONDS, RosSystem, delivered, first_line, pair, rule, run
from .test_nodes import LISTENER, TALKER

SROS2 = """<policy version="0.2.0"><enclaves>{}</enclaves></policy>"""
ENCLAVE = """<enclave path="/{0}"><profiles><profile ns="/" node="{0}">
<topics {1}="ALLOW"><topic>chatter</topic></topics></profile></profiles></enclave>"""


def test_what_was_learned_of_running_nodes_runs_them_secured(ros: RosSystem) -> None:
    usable = graph_source.usable()
    if not usable.usable:
        pytest.skip(f"{usable.reason}; {usable.help}")
    started = [
        ros.program(text, None, "--ros-args", "--enclave", enclave)
        for text, enclave in ((TALKER, "/talker"), (LISTENER, "/listener"))
    ]
    assert "heard hello" in first_line(started[1], lambda line: "heard" in line)
    ros.keymint("discover", "--domain", "0", "--seconds", "5", "-o", ros.folder / "graph.json", inside=True)
    for each in started:
        each.kill()
        each.wait()
    ros.keymint("learn", ros.folder / "graph.json", "-o", ros.folder / "learned.xml")
    install = ros.provision((ros.folder / "learned.xml").read_text())
    ros.program(TALKER, install, "--ros-args", "--enclave", "/talker")
    listener = ros.program(LISTENER, install, "--ros-args", "--enclave", "/listener")
    assert "heard hello" in first_line(listener, lambda line: "heard" in line)
    turned = ros.program(LISTENER, install, "--ros-args", "--enclave", "/talker")
    assert "Error" in first_line(turned, lambda line: "heard" in line)
    ros.keymint("verify", "-w", ros.folder / "ws", "--ros")


def test_what_ros2_security_made_is_adopted_and_hardened_while_nodes_run(ros: RosSystem) -> None:
    keystore, file = ros.folder / "sros2", ros.folder / "policy.xml"
    file.write_text(SROS2.format(ENCLAVE.format("talker", "publish") + ENCLAVE.format("listener", "subscribe")))
    try:
        ros.ros2(None, "security", "create_keystore", keystore)
        for name in ("talker", "listener"):
            ros.ros2(None, "security", "create_enclave", keystore, f"/{name}")
            ros.ros2(None, "security", "create_permission", keystore, f"/{name}", file)
    except (AssertionError, FileNotFoundError) as error:
        pytest.skip(f"'ros2 security' does not work here: {str(error)[-200:]}")
    talker, listener = pair(ros, keystore)
    assert delivered(talker, listener, SECONDS)
    workspace = ros.folder / "ws"
    ros.keymint("adopt", keystore, file, "--apply", "-w", workspace)
    adopted = workspace / "install"
    ros.keymint("build", "-w", workspace)
    ros.keymint("install", "-w", workspace)
    for name in ("cert.pem", "permissions.p7s", "governance.p7s"):
        assert (adopted / "enclaves/talker" / name).read_bytes() == (keystore / "enclaves/talker" / name).read_bytes()
    mixed, _ = pair(ros, adopted, keystore)
    assert delivered(mixed, listener, SECONDS, "adopted to original")
    ros.keymint("verify", "-w", workspace, "--ros")
    ros.keymint("harden", "authority", "--apply", "--flag-day", "-w", workspace)
    after, listening = pair(ros, adopted)
    assert delivered(after, listening, SECONDS, "hardened")
    assert not delivered(talker, listening, 3.0, "of before the flag day")
    ros.keymint("verify", "-w", workspace, "--ros")


def test_ros2_keymint(ros: RosSystem) -> None:
    """By the shim, which works whatever Python ROS has."""
    if shutil.which("ros2") is None:
        pytest.skip("there is no ros2 on PATH")
    site = ros.folder / "site"
    shutil.copytree(CHECKOUT / "examples/ros2_shim/keymint_ros2cli", site / "keymint_ros2cli")
    metadata = site / "keymint_ros2cli-1.0.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: keymint_ros2cli\nVersion: 1.0.0\n")
    (metadata / "entry_points.txt").write_text("[ros2cli.command]\nkeymint = keymint_ros2cli:KeymintCommand\n")
    variables = dict(ros.network.variables(None))
    variables["PYTHONPATH"] = os.pathsep.join((variables.get("PYTHONPATH", ""), str(site)))
    variables["PATH"] = os.pathsep.join((variables["PATH"], str(Path(sys.executable).parent)))
    ros2 = [*ros.network.inside, "ros2", "keymint"]
    assert "keymint" in run([*ros2, "--version"], variables, ros.folder, 0)
    file = ros.folder / "p.xml"  # 'nsenter' leaves the current folder
    file.write_text(
        f'<profiles xmlns:xi="http://www.w3.org/2001/XInclude"><profile name="a"><attachment>/a</attachment>{GRAPH}'
        f"{rule('ros_topic', '/b', 'ros_publish')}</profile></profiles>"
    )
    run([*ros2, "provision", str(file), "-w", str(ros.folder / "made")], variables, ros.folder, 0)
    found = json.loads(
        run([*ros2, "query", str(file), "who", "can", "publish", "/b", "--json"], variables, ros.folder, 0)
    )
    assert "/a" in json.dumps(found["result"])
    assert ros.refusal(ros.folder / "made/install", "/a") == ""
