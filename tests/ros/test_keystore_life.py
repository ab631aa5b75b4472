# SPDX-License-Identifier: Apache-2.0
"""Revoke, renew, narrow and expire while nodes run."""

from __future__ import annotations

import re
import shutil
import time
from datetime import UTC, datetime, timedelta

from .ros_system import GRAPH, PAIR, SECONDS, SILENCE, RosSystem, delivered, kept, pair, policy, rule, tried

NARROWED = policy(
    {
        "/talker": GRAPH + rule("ros_topic", "/other", "ros_publish"),
        "/listener": GRAPH + rule("ros_topic", "/*", "ros_subscribe"),
    }
)
WIDE = NARROWED.replace("/other", "/chatter")


def test_a_stolen_enclave_is_refused_by_peers_that_restarted_and_the_robot_comes_back(ros: RosSystem) -> None:
    install, workspace = ros.provision(PAIR), ros.folder / "ws"
    stolen = shutil.copytree(install, ros.folder / "stolen", symlinks=True)
    running, listener = pair(ros, install)
    assert delivered(running, listener, SECONDS)
    ros.keymint("revoke", "talker", "--reason", "key-compromise", "-w", workspace)
    assert delivered(running, listener, SECONDS), "a running peer read its list when it started"
    assert ros.refusal(install, "/talker")
    listener.reap()
    restarted = ros.node(install, "/listener")
    kept(restarted, "in", "ros_subscribe", "/chatter")
    thief = ros.node(stolen, "/talker")
    kept(thief, "out", "ros_publish", "/chatter")
    assert not delivered(thief, restarted, SILENCE)
    assert not delivered(running, restarted, SILENCE)
    ros.keymint("renew", "--rekey", "talker", "-w", workspace)
    back, listener = pair(ros, install)
    assert delivered(back, listener, SECONDS)
    assert not delivered(thief, listener, SILENCE)


def test_a_renewed_enclave_and_one_that_is_not_mix(ros: RosSystem) -> None:
    install = ros.provision(PAIR)
    talker, listener = pair(ros, install)
    assert delivered(talker, listener, SECONDS)
    ros.keymint("renew", "talker", "-w", ros.folder / "ws")
    renewed = ros.node(install, "/talker")
    kept(renewed, "out", "ros_publish", "/chatter")
    assert delivered(renewed, listener, SECONDS, "renewed")
    assert delivered(talker, listener, SECONDS, "as before")


def test_a_narrowed_right_ends_for_the_old_files_too(ros: RosSystem) -> None:
    install = ros.provision(WIDE)
    old = shutil.copytree(install, ros.folder / "old", symlinks=True)
    talker, listener = pair(ros, install)
    assert delivered(talker, listener, SECONDS)
    ros.provision(NARROWED, "ws", "--revoke-superseded")
    narrowed = ros.node(install, "/talker")
    assert not tried(narrowed, "ros_publish", "/chatter")
    assert tried(narrowed, "ros_publish", "/other")
    listener.reap()
    restarted = ros.node(install, "/listener")
    kept(restarted, "in", "ros_subscribe", "/chatter")
    replayed = ros.node(old, "/talker")
    kept(replayed, "out", "ros_publish", "/chatter")
    assert not delivered(replayed, restarted, SILENCE)


def test_a_certificate_ends_while_nodes_run(ros: RosSystem) -> None:
    workspace, install = ros.folder / "ws", ros.provision(PAIR)
    end = datetime.now(UTC) + timedelta(seconds=60)
    for name in ("identities.xml", "permissions.xml"):
        file = workspace / "profile/package.defaults" / name
        ends = f"<not_after>{end:%Y-%m-%dT%H:%M:%S}</not_after>"
        file.write_text(re.sub("<not_after>.*</not_after>", ends, file.read_text()))
    ros.provision(PAIR)
    talker, listener = pair(ros, install)
    assert delivered(talker, listener, max(1.0, (end - datetime.now(UTC)).total_seconds()))
    time.sleep(max(0.0, (end - datetime.now(UTC)).total_seconds()) + 2)
    assert ros.refusal(install, "/talker")
    if "cyclonedds" in ros.network.rmw:  # other vendors go on with a peer that they have met
        assert not delivered(talker, listener, SILENCE, "late")
    ros.keymint("renew", "-w", workspace)
    renewed, listener = pair(ros, install)
    assert delivered(renewed, listener, SECONDS)
