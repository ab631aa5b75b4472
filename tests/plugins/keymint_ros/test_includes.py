# SPDX-License-Identifier: Apache-2.0
"""The shipped includes for nodes whose name is not that of their enclave: the command line, tf2, and components."""

from __future__ import annotations

from pathlib import Path

import pytest
from keymint_ros.distros import library

import comarmor
from comarmor.errors import ComArmorError

SIX = (
    "describe_parameters", "get_parameter_types", "get_parameters", "list_parameters", "set_parameters",
    "set_parameters_atomically",
)  # fmt: skip
TYPES = "get_type_description"
FAMILIES = ("foxy", "humble", "iron", "jazzy", "rolling")


def including(folder: Path, file: str, distro: str, before: str = "") -> comarmor.Policy:
    """Return the policy of the subject ``/ns/n``, which includes a file alone."""
    (folder / "p.xml").write_text(
        '<profile xmlns:xi="http://www.w3.org/2001/XInclude" name="n"><attachment>/ns/n</attachment>'
        f'{before}<xi:include href="common/{file}" parse="xml"/></profile>'
    )
    return comarmor.load(folder / "p.xml", library=library(distro))


def may(policy: comarmor.Policy, permission: str, name: str) -> bool:
    kind = {"ros_execute": "ros_service", "ros_call": "ros_service"}.get(permission, "ros_topic")
    kind = kind if permission.startswith("ros_") else "topic"
    return policy.decide("/ns/n", kind, permission, name).allowed


@pytest.mark.parametrize("distro", FAMILIES)
def test_the_command_line_and_its_daemon(tmp_path: Path, distro: str) -> None:
    policy, has_types = including(tmp_path, "cli.xml", distro), distro not in {"foxy", "humble"}
    for node in ("/_ros2cli_4711", "/_ros2cli_daemon_0_5f2e0a31"):
        assert all(may(policy, "ros_execute", f"{node}/{name}") for name in SIX)
        assert may(policy, "ros_execute", f"{node}/{TYPES}") == has_types
    for permission in ("publish", "subscribe"):
        assert may(policy, permission, "ros_discovery_info")
        assert may(policy, f"ros_{permission}", "/parameter_events")
    assert may(policy, "ros_publish", "/rosout")
    # Nothing beyond: what people may do are rules of their own.
    assert not may(policy, "ros_subscribe", "/rosout")
    assert not may(policy, "ros_subscribe", "/chatter")
    assert not any(may(policy, "ros_call", f"/talker/{name}") for name in (*SIX, TYPES))
    assert not any(may(policy, "ros_execute", f"{node}/{TYPES}") for node in ("/ns/n", "/talker", "/x/_ros2cli_1"))


@pytest.mark.parametrize("distro", FAMILIES)
def test_a_listener_of_tf2(tmp_path: Path, distro: str) -> None:
    policy, has_types = including(tmp_path, "tf.xml", distro), distro not in {"foxy", "humble"}
    for topic in ("/tf", "/tf_static"):
        assert may(policy, "ros_subscribe", topic)
        assert not may(policy, "ros_publish", topic)
    for namespace in ("", "/ns"):
        assert may(policy, "ros_execute", f"{namespace}/transform_listener_impl_5581f0a3/{TYPES}") == has_types
    assert not may(policy, "ros_execute", f"/other/transform_listener_impl_5581f0a3/{TYPES}")
    assert not may(policy, "ros_execute", "/transform_listener_impl_5581f0a3/get_parameters")


@pytest.mark.parametrize("distro", FAMILIES)
def test_components_in_a_container(tmp_path: Path, distro: str) -> None:
    tunable = '<tunable name="COMPONENT"><value>/camera</value><value>/robot1/rectify</value></tunable>'
    policy, has_types = including(tmp_path, "component.xml", distro, tunable), distro not in {"foxy", "humble"}
    for node in ("/camera", "/robot1/rectify"):
        assert all(may(policy, "ros_execute", f"{node}/{name}") for name in SIX)
        assert may(policy, "ros_execute", f"{node}/{TYPES}") == has_types
    assert not any(may(policy, "ros_execute", f"{node}/{SIX[0]}") for node in ("/ns/n", "/rectify", "/robot1/camera"))


def test_a_component_without_a_name_is_an_error_that_says_what_to_declare(tmp_path: Path) -> None:
    with pytest.raises(ComArmorError) as caught:
        including(tmp_path, "component.xml", "jazzy")
    message = str(caught.value.diagnostics[0])
    assert "included from" in message
    assert "@{COMPONENT} is unknown here (declare it with <tunable> above its use)" in message
