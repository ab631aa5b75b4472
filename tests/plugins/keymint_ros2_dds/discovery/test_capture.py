# SPDX-License-Identifier: Apache-2.0
"""A capture of a DDS domain as a graph."""

from __future__ import annotations

import pytest
from keymint_ros2_dds.discovery.capture import DiscoveredEndpoint, DiscoveredParticipant, discovered_graph

from comarmor.errors import Severity
from keymint.api import DiscoveredGraph
from keymint.api.graph import Edge, Object

ONE, OTHER = "0" * 31 + "1", "0" * 31 + "2"
NAMES = {ONE: "/talker", OTHER: "/listener"}
PARTICIPANTS = (DiscoveredParticipant(ONE, 0), DiscoveredParticipant(OTHER, 7))


def warnings(found: DiscoveredGraph) -> list[tuple[str, str]]:
    return [(each.code, each.subject) for each in found.diagnostics if each.severity is Severity.WARNING]


def test_endpoints_are_edges_in_the_domain_of_their_participant() -> None:
    endpoints = (
        DiscoveredEndpoint(ONE, "publish", "rt/chatter", "std_msgs::msg::dds_::String_"),
        DiscoveredEndpoint(OTHER, "subscribe", "chatter", "", ("q", "p", "q")),
    )
    found = discovered_graph(PARTICIPANTS, endpoints, NAMES)
    assert set(found.graph.edges) == {
        Edge("/talker", "publish", Object("topic", "rt/chatter"), 0),
        Edge("/listener", "subscribe", Object("topic", "chatter", ("p", "q")), 7),
    }
    assert list(found.graph.types) == [(Object("topic", "rt/chatter"), "std_msgs::msg::dds_::String_")]
    assert warnings(found) == []


def test_the_order_of_a_capture_makes_no_difference() -> None:
    endpoints = tuple(DiscoveredEndpoint(guid, "publish", topic) for guid in (ONE, OTHER) for topic in ("b", "a"))
    assert discovered_graph(PARTICIPANTS, endpoints, NAMES) == discovered_graph(
        PARTICIPANTS[::-1], endpoints[::-1], NAMES
    )


@pytest.mark.parametrize(
    "odd",
    [
        DiscoveredEndpoint(ONE, "publish", ""),
        DiscoveredEndpoint(ONE, "publish", "a\x00b"),
        DiscoveredEndpoint(ONE, "publish", "a", "T\n"),
        DiscoveredEndpoint(ONE, "publish", "a", "T", ("\x1b[0m",)),
    ],
)
def test_names_that_are_not_legal_are_left_out_with_a_warning(odd: DiscoveredEndpoint) -> None:
    sound = DiscoveredEndpoint(ONE, "publish", "sound")
    found = discovered_graph(PARTICIPANTS, (odd, odd, sound), NAMES)
    assert [edge.object.name for edge in found.graph.edges] == ["sound"]
    assert warnings(found) == [("endpoint-odd", "/talker")]
