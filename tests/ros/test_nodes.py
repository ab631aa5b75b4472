# SPDX-License-Identifier: Apache-2.0
"""Nodes of ROS and their enclaves: names, domains, namespaces, intruders, and what ships for every node."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from keymint_ros.distros import library

from tests.conftest import CHECKOUT
from tests.test_readme import README, saved_files

from .ros_system import (
    GRAPH,
    NODE,
    PAIR,
    SECONDS,
    SILENCE,
    RosSystem,
    answered,
    delivered,
    first_line,
    kept,
    pair,
    policy,
    rule,
    tried,
)

TALKER = """
import sys, rclpy
from rclpy.node import Node
from std_msgs.msg import String
rclpy.init(args=sys.argv)
node = Node("talker")
publisher = node.create_publisher(String, "chatter", 10)
node.create_timer(0.1, lambda: publisher.publish(String(data="hello")))
print("publishes", publisher.topic_name if hasattr(publisher, "topic_name") else publisher.topic, flush=True)
rclpy.spin(node)
"""
LISTENER = """
import sys, rclpy
from rclpy.node import Node
from std_msgs.msg import String
rclpy.init(args=sys.argv)
node = Node("listener")
node.create_subscription(String, "chatter", lambda message: print("heard", message.data, flush=True), 10)
rclpy.spin(node)
"""
"""As a user writes them, with default options."""


# -- enclaves -------------------------------------------------------------------------------------------------------


def test_a_node_starts_in_its_enclave_and_in_no_other(ros: RosSystem) -> None:
    install = ros.provision(PAIR)
    assert ros.refusal(install, "/talker") == ""
    assert "does not exist" in ros.refusal(install, "/robot9/talker")
    assert "does not exist" in ros.refusal(install, "/talke")
    node = ros.node(install, "/listener")  # whatever a node is called, its rights are those of its enclave
    assert not tried(node, "ros_publish", "/chatter")
    assert tried(node, "ros_subscribe", "/chatter")


def test_without_an_enclave_a_node_takes_the_root_enclave(ros: RosSystem) -> None:
    install = ros.provision(PAIR)
    assert ros.refusal(install, "/")
    rules = {"/": GRAPH + rule("ros_topic", "/chatter", "ros_subscribe")}
    install = ros.provision(policy(rules), "root")
    node = ros.node(install, "/")
    assert tried(node, "ros_subscribe", "/chatter")
    assert not tried(node, "ros_publish", "/chatter")
    assert ros.refusal(install, "/talker")


def test_the_root_enclave_that_the_documentation_shows_runs_a_node(ros: RosSystem) -> None:
    """A plain node needs more than its own topic: what the page leaves out, its node lacks."""
    page = (CHECKOUT / "docs/deploying.md").read_text()
    shown = re.search(r"## The root enclave.*?```xml\n(.*?)```", page, re.DOTALL)
    assert shown
    install = ros.provision(f'<profiles xmlns:xi="http://www.w3.org/2001/XInclude">{shown[1]}</profiles>')
    node = ros.node(install, "/")
    assert tried(node, "ros_subscribe", "/chatter")
    name = re.search(r"/(\w+|\*)/get_type_description", shown[1])
    whole = "/rosout" in shown[1] or "logging.xml" in shown[1]
    answer, text = node.ask("NODE", name[1].replace("*", "any") if name else "any", "/")
    assert (answer == "ALLOWED") == whole, text


def test_a_domain_that_no_document_names_is_refused(ros: RosSystem) -> None:
    zero, five = ros.provision(PAIR), ros.provision(PAIR, "five", "--domain", "5")
    assert ros.refusal(zero, "/talker", 0) == ros.refusal(five, "/talker", 5) == ""
    assert ros.refusal(zero, "/talker", 5)
    assert ros.refusal(five, "/talker", 0)


# -- names ----------------------------------------------------------------------------------------------------------


def test_rights_are_about_names_after_namespace_and_remapping(ros: RosSystem) -> None:
    rules = NODE + rule("ros_topic", "/robot1/chatter", "ros_publish", "ros_subscribe")
    install = ros.provision(policy({"/robot1/talker": rules, "/robot1/listener": rules}))
    inside = ("--ros-args", "-r", "__ns:=/robot1", "--enclave")
    talker = ros.program(TALKER, install, *inside, "/robot1/talker")
    assert "publishes /robot1/chatter" in first_line(talker, lambda line: "publishes" in line)
    listener = ros.program(LISTENER, install, *inside, "/robot1/listener")
    assert "heard hello" in first_line(listener, lambda line: "heard" in line)
    elsewhere = ros.program(TALKER, install, *inside, "/robot1/talker", "-r", "chatter:=/chatter")
    assert "Error" in first_line(elsewhere, lambda line: "publishes" in line)
    remapped = ros.program(TALKER, install, *inside, "/robot1/talker", "-r", "chatter:=/robot1/chatter")
    assert "publishes" in first_line(remapped, lambda line: "publishes" in line)
    unnamed = ros.program(TALKER, install, "--ros-args", "--enclave", "/robot1/talker")
    assert "Error" in first_line(unnamed, lambda line: "publishes" in line)


# -- what ships -----------------------------------------------------------------------------------------------------


COMPONENT = '<tunable name="COMPONENT"><value>/cell/part</value></tunable>'
SECOND = {"component.xml": [("part", "/cell")], "cli.xml": [("_ros2cli_4711", "/"), ("_ros2cli_daemon_0_5f2e", "/")]}
"""The nodes beside that of the subject's own name which an include is about, with their namespaces."""


def shipped(distro: str) -> list[str]:
    """Return the files of this distribution that policies include for a whole node or program."""
    return sorted(each.name for each in (library(distro) / "common").glob("*.xml"))


def test_every_include_that_ships_is_provisioned_and_runs_its_node(ros: RosSystem) -> None:
    found = shipped(ros.network.variables(None)["ROS_DISTRO"])
    assert "node.xml" in found
    for file in found:
        name = file.removesuffix(".xml")
        include = f'{NODE}{COMPONENT}<xi:include href="common/{file}" parse="xml"/>'
        install = ros.provision(policy({f"/cell/{name}": include}), name)
        node = ros.node(install, f"/cell/{name}")
        assert node.ask("NODE", name, "/cell") == ("ALLOWED", ""), file
        if file == "node.xml":
            assert node.ask("NODE", "other", "/cell")[0] == "DENIED"
            assert node.ask("NODE", name, "/")[0] == "DENIED"
        for other, namespace in SECOND.get(file, ()):
            assert node.ask("NODE", other, namespace) == ("ALLOWED", ""), (file, other)


def test_the_quick_start_of_readme_runs(ros: RosSystem) -> None:
    [(_, text)] = saved_files(README)
    install = ros.provision(text)
    camera, detector, planner = (ros.node(install, f"/{each}") for each in ("camera", "detector", "planner"))
    for node, name in ((camera, "camera"), (detector, "detector"), (planner, "planner")):
        assert node.ask("NODE", name, "/") == ("ALLOWED", "")
    kept(camera, "out", "ros_publish", "/image")
    kept(detector, "in", "ros_subscribe", "/image")
    assert delivered(camera, detector, SECONDS)
    kept(planner, "out", "ros_call", "/find_object")
    kept(detector, "in", "ros_execute", "/find_object")
    assert answered(planner, detector, SECONDS)
    for node, permission, name in (
        (camera, "ros_subscribe", "/image"),
        (planner, "ros_subscribe", "/image"),
        (camera, "ros_call", "/find_object"),
        (planner, "ros_execute", "/find_object"),
        (detector, "ros_publish", "/image"),
    ):
        assert not tried(node, permission, name)


# -- intruders ------------------------------------------------------------------------------------------------------


@pytest.fixture
def install(ros: RosSystem) -> Path:
    return ros.provision(PAIR)


def test_a_node_without_security_neither_sends_nor_receives(ros: RosSystem, install: Path) -> None:
    talker, listener = pair(ros, install)
    intruder, eavesdropper = (
        ros.node(None, "/talker"),
        ros.node(None, "/listener"),
    )
    kept(intruder, "out", "ros_publish", "/chatter")
    kept(eavesdropper, "in", "ros_subscribe", "/chatter")
    assert delivered(intruder, eavesdropper, SECONDS, "among themselves")
    assert delivered(talker, listener, SECONDS)
    assert not delivered(intruder, listener, SILENCE, "forged")
    assert not delivered(talker, eavesdropper, SILENCE, "secret")


def test_an_enclave_of_another_keystore_neither_sends_nor_receives(ros: RosSystem, install: Path) -> None:
    foreign = ros.provision(PAIR, "foreign")
    talker, listener = pair(ros, install)
    intruder, eavesdropper = pair(ros, foreign)
    assert delivered(intruder, eavesdropper, SECONDS, "among themselves")
    assert delivered(talker, listener, SECONDS)
    assert not delivered(intruder, listener, SILENCE, "forged")
    assert not delivered(talker, eavesdropper, SILENCE, "secret")
