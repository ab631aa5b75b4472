# SPDX-License-Identifier: Apache-2.0
"""Files of the library stand for rules only where they grant nothing else."""

from __future__ import annotations

import pytest
from keymint_ros2_sros2.translate import atoms, common_files

from comarmor.data import locate
from comarmor.errors import Origin
from comarmor.rules import Effect, Rule

LIBRARY = locate("keymint_ros", "templates") / "comarmor.d"
HERE = Origin("policy.xml", 1)
SERVED = (
    "describe_parameters", "get_parameter_types", "get_parameters", "list_parameters", "set_parameters",
    "set_parameters_atomically",
)  # fmt: skip


def rule(kind: str, permissions: tuple[str, ...], *names: str, effect: Effect = Effect.ALLOW) -> Rule:
    return Rule(effect, kind, permissions, names, (), False, HERE)


CLOCK = rule("ros_topic", ("ros_subscribe",), "/clock")
LOG = rule("ros_topic", ("ros_publish",), "/rosout")
EVENTS = rule("ros_topic", ("ros_publish", "ros_subscribe"), "/parameter_events")
GRAPH = rule("topic", ("publish", "subscribe"), "ros_discovery_info")


def served(subject: str) -> Rule:
    return rule("ros_service", ("ros_execute", "ros_call"), *(f"{subject}/{name}" for name in SERVED))


def test_all_that_a_node_needs_is_one_file() -> None:
    wanted = atoms([CLOCK, LOG, EVENTS, GRAPH, served("/talker")])
    found = common_files(LIBRARY / "foxy", "/talker", wanted)
    assert list(found) == ["common/node.xml"]
    left = wanted - found["common/node.xml"]
    assert left == atoms([rule("ros_service", ("ros_call",), *(f"/talker/{name}" for name in SERVED))])


def test_a_part_is_used_where_the_whole_grants_more() -> None:
    wanted = atoms([CLOCK, LOG, EVENTS, GRAPH, served("/talker")])
    assert set(common_files(LIBRARY / "iron", "/talker", wanted)) == {
        f"common/node/{name}.xml" for name in ("graph", "logging", "parameter_events", "parameters", "time")
    }


def test_parameters_of_another_node_are_not_those_of_the_subject() -> None:
    assert common_files(LIBRARY / "foxy", "/robot/talker", atoms([served("/talker")])) == {}


@pytest.mark.parametrize(
    "wanted",
    [
        [rule("ros_topic", ("ros_subscribe",), "/clock", effect=Effect.DENY)],
        [rule("ros_topic", ("ros_publish",), "/clock")],
        [rule("ros_topic", ("ros_publish",), "/ns/rosout")],
        [rule("ros_topic", ("ros_subscribe",), "/*")],
        [],
    ],
)
def test_nothing_else_is_replaced(wanted: list[Rule]) -> None:
    assert common_files(LIBRARY / "foxy", "/talker", atoms(wanted)) == {}
