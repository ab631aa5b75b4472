# SPDX-License-Identifier: Apache-2.0
"""The middleware of ROS 2 Ardent asks for other endpoints than the names of an edge say."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import pytest
from keymint_ros2_dds.lowering.endpoints import endpoints
from keymint_ros2_dds.transports import ardent_omg
from keymint_ros2_dds.transports.ardent_middleware import DEVIATION, ArdentMiddleware, created_endpoints

from comarmor.errors import Origin
from keymint.api import Availability, Environment, InstalledEnclave, Tier, Verdict
from keymint.api.graph import Edge, Object

SERVICE = Edge("/t", "ros_call", Object("ros_service", "/n/s"))
TOPIC = Edge("/t", "ros_publish", Object("ros_topic", "/n/x"))
PARAMETERS = Edge("/t", "ros_write", Object("ros_parameter", "/n"))
RULE = Origin("permissions.xml", 7)
RAW = Edge("/t", "publish", Object("topic", "sRequest", ("rq/n",)))


class Recorder:
    """A transport that allows what it is told to, and remembers what it was asked."""

    def __init__(self, *allowed: str) -> None:
        self.allowed = allowed
        self.asked: list[Edge] = []

    def usable(self) -> Availability:
        return Availability(usable=True, version="1", tiers=tuple(Tier))

    def label(self, enclaves, edges, tier):
        assert (len(enclaves), tier) == (1, Tier.DECISION)
        for edge in edges:
            self.asked.append(edge)
            yield edge, Verdict(edge.object.name in self.allowed, edge.object.name, RULE)


def label(transport: Recorder, *edges: Edge, distro: str = "ardent") -> list[tuple[Edge, Verdict]]:
    enclaves = [InstalledEnclave("/t", Path("/nowhere/t"), distro, Path("/nowhere"))]
    return list(ArdentMiddleware(transport).label(enclaves, edges, Tier.DECISION))


def test_the_endpoints_of_services_are_created_in_the_empty_partition():
    assert [
        (each.permission, each.object.name, each.object.partitions) for each in created_endpoints("ardent", SERVICE)
    ] == [
        ("publish", "sRequest", ()),
        ("subscribe", "sReply", ()),
    ]
    assert {each.object.partitions for each in created_endpoints("ardent", PARAMETERS)} == {()}


@pytest.mark.parametrize(
    ("distro", "edge"), [("ardent", TOPIC), ("ardent", RAW), ("bouncy", SERVICE), ("jazzy", TOPIC)]
)
def test_all_else_is_created_where_it_belongs(distro, edge):
    assert created_endpoints(distro, edge) == endpoints(distro, edge)


def test_an_edge_is_allowed_when_all_of_its_endpoints_are():
    labelled = label(Recorder("sRequest", "x"), SERVICE, TOPIC, RAW)
    assert [edge for edge, _ in labelled] == [SERVICE, TOPIC, RAW]
    assert [verdict.allowed for _, verdict in labelled] == [False, True, True]
    assert labelled[0][1].reason == "subscribe sReply in the empty partition: sReply"
    assert (labelled[0][1].where, labelled[0][1].deviation) == (RULE, DEVIATION)
    assert (labelled[1][1].reason, labelled[1][1].deviation) == ("publish x in rt/n: x", "")
    assert labelled[2][1] == Verdict(allowed=True, reason="sRequest", where=RULE)
    assert label(Recorder("sRequest", "sReply"), SERVICE)[0][1].allowed


def test_edges_are_asked_as_they_come():
    transport = Recorder()

    def edges():
        for number in range(3):
            assert len(transport.asked) == 2 * number
            yield SERVICE

    enclaves = [InstalledEnclave("/t", Path("/nowhere/t"), "ardent", Path("/nowhere"))]
    assert len(list(ArdentMiddleware(transport).label(enclaves, edges(), Tier.DECISION))) == 3


def test_it_is_asked_only_when_it_is_named_and_never_for_data():
    usable = ArdentMiddleware(Recorder()).usable()
    assert (usable.by_default, usable.tiers) == (False, (Tier.DECISION, Tier.ADMISSION))


def test_the_registered_one_stands_on_the_simulated_standard(tmp_path: Path):
    usable = ardent_omg.open(Environment(datetime(2027, 1, 1, tzinfo=UTC), tmp_path)).usable()
    assert (usable.usable, usable.by_default) == (True, False)
