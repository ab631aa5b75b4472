# SPDX-License-Identifier: Apache-2.0
"""The environment variables of ROS 2 by distribution and layout."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import pytest
from keymint_ros2_dds import build_type
from keymint_ros2_dds.enclave_layout import enclave_variables, keystore_variables

from keymint.api import EnvironmentVariable
from keymint.stages.environment_scripts import variable_values

SWITCHES = {"ROS_SECURITY_ENABLE": "true", "ROS_SECURITY_STRATEGY": "Enforce"}


def values(variables: Iterable[EnvironmentVariable]) -> dict[str, str]:
    found = dict(variable_values(variables, Path("/k")))
    assert {name: found.pop(name) for name in SWITCHES} == SWITCHES
    return found


@pytest.mark.parametrize("distro", ["foxy", "humble", "jazzy", "rolling", "of_the_future"])
def test_from_foxy_on(distro: str) -> None:
    assert values(keystore_variables(distro, "sros2")) == {"ROS_SECURITY_KEYSTORE": "/k"}
    assert values(enclave_variables(distro, "sros2", "/r/talker", ())) == {
        "ROS_SECURITY_KEYSTORE": "/k", "ROS_SECURITY_ENCLAVE_OVERRIDE": "/r/talker"
    }  # fmt: skip


@pytest.mark.parametrize("distro", ["crystal", "dashing", "eloquent"])
@pytest.mark.parametrize(("layout", "root"), [("flat", "/k"), ("sros2", "/k/enclaves")])
def test_before_foxy(distro: str, layout: str, root: str) -> None:
    assert values(keystore_variables(distro, layout)) == {"ROS_SECURITY_ROOT_DIRECTORY": root}
    assert values(enclave_variables(distro, layout, "/r/talker", ())) == {
        "ROS_SECURITY_ROOT_DIRECTORY": root, "ROS_SECURITY_NODE_DIRECTORY": f"{root}/r/talker"
    }  # fmt: skip


@pytest.mark.parametrize("distro", ["ardent", "bouncy"])
def test_the_first_two_look_for_a_node_without_its_namespace(distro: str) -> None:
    assert values(keystore_variables(distro, "flat")) == {"ROS_SECURITY_ROOT_DIRECTORY": "/k"}
    assert values(enclave_variables(distro, "flat", "/talker", ())) == {"ROS_SECURITY_ROOT_DIRECTORY": "/k"}
    assert values(enclave_variables(distro, "flat", "/r/s/talker", ())) == {"ROS_SECURITY_ROOT_DIRECTORY": "/k/r/s"}


def test_the_build_type_has_them() -> None:
    assert build_type.keystore_variables("jazzy", "sros2") == keystore_variables("jazzy", "sros2")
