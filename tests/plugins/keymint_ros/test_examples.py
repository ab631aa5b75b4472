# SPDX-License-Identifier: Apache-2.0
"""The example policies decide as their READMEs describe."""

from __future__ import annotations

from pathlib import Path

import pytest
from keymint_ros import profile_type

import comarmor

EXAMPLES = Path(__file__).resolve().parents[3] / "examples"
POLICIES = ("talker_listener", "add_two_ints", "action", "fleet")
FROM_FOXY = ("operator",)
"""Examples that include files which no earlier distribution has."""


def _load(name: str, distro: str = "jazzy") -> comarmor.Policy:
    return comarmor.load(EXAMPLES / name, library=profile_type.library(distro))


@pytest.mark.parametrize("distro", ["bouncy", "humble", "rolling"])
@pytest.mark.parametrize("name", POLICIES)
def test_an_example_loads_for_every_family_of_distros(name: str, distro: str) -> None:
    policy = _load(name, distro)
    assert policy.subjects()
    for subject in policy.subjects():
        assert policy.decide(subject, "ros_topic", "ros_publish", "/rosout").allowed
        assert policy.decide(subject, "ros_service", "ros_execute", f"{subject}/get_parameters").allowed


@pytest.mark.parametrize("name", [*POLICIES, *FROM_FOXY])
def test_the_readme_of_an_example_shows_how_to_provision_it(name: str) -> None:
    assert f"keymint provision examples/{name} -w {name}_ws" in (EXAMPLES / name / "README.md").read_text()


@pytest.mark.parametrize(
    ("name", "subject", "permission", "object_name", "allowed"),
    [
        ("talker_listener", "/talker", "ros_publish", "/chatter", True),
        ("talker_listener", "/talker", "ros_subscribe", "/chatter", False),
        ("talker_listener", "/listener", "ros_subscribe", "/chatter", True),
        ("add_two_ints", "/add_two_ints_server", "ros_execute", "/add_two_ints", True),
        ("add_two_ints", "/add_two_ints_client", "ros_execute", "/add_two_ints", False),
        ("add_two_ints", "/add_two_ints_client", "ros_read", "/add_two_ints_server", True),
        ("add_two_ints", "/add_two_ints_client", "ros_write", "/add_two_ints_server", False),
        ("action", "/fibonacci_action_server", "ros_operate", "/fibonacci", True),
        ("action", "/fibonacci_action_client", "ros_request", "/fibonacci", True),
        ("action", "/fibonacci_monitor", "ros_request", "/fibonacci", False),
        ("action", "/fibonacci_monitor", "ros_subscribe", "/fibonacci/_action/feedback", True),
        ("fleet", "/robot2/base", "ros_subscribe", "/robot2/cmd_vel", True),
        ("fleet", "/robot2/base", "ros_subscribe", "/robot1/cmd_vel", False),
        ("fleet", "/robot2/lidar", "ros_subscribe", "/robot2/cmd_vel", False),
        ("fleet", "/robot3/navigator", "ros_operate", "/robot3/navigate", True),
        ("fleet", "/robot3/navigator", "ros_publish", "/robot3/cmd_vel", True),
        ("fleet", "/robot3/lidar", "ros_subscribe", "/fleet/emergency_stop", True),
        ("fleet", "/robot3/lidar", "ros_publish", "/fleet/emergency_stop", False),
        ("fleet", "/fleet/dispatcher", "ros_request", "/robot1/navigate", True),
        ("fleet", "/fleet/dashboard", "ros_subscribe", "/robot1/odom", True),
        ("fleet", "/fleet/dashboard", "ros_subscribe", "/robot1/private/log", False),
        ("fleet", "/fleet/dashboard", "ros_publish", "/robot1/odom", False),
    ],
)
def test_an_example_decides_as_described(
    name: str, subject: str, permission: str, object_name: str, allowed: bool
) -> None:
    kinds = {"ros_execute": "ros_service", "ros_read": "ros_parameter", "ros_write": "ros_parameter"}
    kinds |= {"ros_operate": "ros_action", "ros_request": "ros_action"}
    decision = _load(name).decide(subject, kinds.get(permission, "ros_topic"), permission, object_name)
    assert decision.allowed == allowed


def test_audited_rules_of_the_fleet_are_marked() -> None:
    policy = _load("fleet")
    assert policy.decide("/fleet/dispatcher", "ros_topic", "ros_publish", "/fleet/emergency_stop").audit
    assert policy.decide("/fleet/dashboard", "ros_topic", "ros_subscribe", "/robot1/private/log").audit
    assert not policy.decide("/fleet/dashboard", "ros_topic", "ros_subscribe", "/robot1/odom").audit
