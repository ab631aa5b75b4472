# SPDX-License-Identifier: Apache-2.0
"""How participants come by the names of subjects."""

from __future__ import annotations

import pytest
from keymint_ros2_dds.discovery.capture import DiscoveredEndpoint, DiscoveredParticipant, discovered_graph

from comarmor.errors import Severity
from keymint.errors import KeymintError

GUID = "0110a5a5deadbeef00000001000001c1"
OTHER = "0110a5a5deadbeef00000002000001c1"


def named(
    participant: DiscoveredParticipant, *endpoints: DiscoveredEndpoint, names: dict[str, str] | None = None
) -> str:
    (subject,) = discovered_graph((participant,), endpoints, names or {}).graph.subjects
    return subject


def serves(node: str) -> DiscoveredEndpoint:
    return DiscoveredEndpoint(GUID, "subscribe", f"rq{node}/get_parametersRequest")


def describes(node: str) -> DiscoveredEndpoint:
    """Return what a server of type descriptions receives requests by, which each node is since Iron."""
    return DiscoveredEndpoint(GUID, "subscribe", f"rq{node}/get_type_descriptionRequest")


HELPER = "/transform_listener_impl_5581f0a3"


@pytest.mark.parametrize(
    ("name", "user_data", "endpoints", "subject"),
    [
        ("talker", b"", (), "/talker"),
        ("/robot1/talker", b"", (), "/robot1/talker"),
        ("", b"enclave=/robot1/arm;", (), "/robot1/arm"),
        ("/", b"enclave=/;", (serves("/robot1/arm"),), "/robot1/arm"),
        ("/", b"enclave=/;\0", (serves("/a"), serves("/b")), f"/participant_{GUID[:24]}"),
        ("/", b"enclave=/;", (describes("/robot1/arm"),), "/robot1/arm"),
        ("/", b"enclave=/;", (describes("/robot1/arm"), describes(HELPER)), "/robot1/arm"),
        ("/", b"enclave=/;", (serves("/arm"), describes("/arm"), describes("/helper")), "/arm"),
        ("/", b"enclave=/;", (describes("/_ros2cli_4711"),), "/_ros2cli_4711"),
        ("/", b"enclave=/;", (describes("/a"), describes("/b")), f"/participant_{GUID[:24]}"),
        ("/", b"enclave=/;", (serves("/a"), serves("/b"), describes("/a")), f"/participant_{GUID[:24]}"),
        (
            "/",
            b"enclave=/;",
            (DiscoveredEndpoint(GUID, "publish", "rq/arm/get_type_descriptionRequest"),),  # a client of the arm
            f"/participant_{GUID[:24]}",
        ),
        ("whatever", b"name=arm;namespace=/robot1;", (), "/robot1/arm"),
        ("x", b"name=arm;namespace=/;", (), "/arm"),
        ("arm", b"", (serves("/robot1/arm"),), "/robot1/arm"),
        (
            "arm",
            b"",
            (DiscoveredEndpoint(GUID, "publish", "get_parametersRequest", "", ("rq/robot1/arm",)),),
            "/robot1/arm",
        ),
        ("arm", b"", (serves("/robot1/leg"),), "/arm"),
        ("RTI Administration Console", b"", (), f"/participant_{GUID[:24]}"),
        ("", b"\xff\xfe;enclave=../../etc;", (), f"/participant_{GUID[:24]}"),
    ],
)
def test_what_it_says_of_itself(
    name: str, user_data: bytes, endpoints: tuple[DiscoveredEndpoint, ...], subject: str
) -> None:
    assert named(DiscoveredParticipant(GUID, 0, name, user_data), *endpoints) == subject


def test_the_user_knows_better() -> None:
    participant = DiscoveredParticipant(GUID, 0, "talker", b"enclave=/x;")
    assert named(participant, names={"0110A5A5.DEADBEEF.00000001": "/mine"}) == "/mine"


def test_the_beginning_of_a_guid_names_all_that_begin_so() -> None:
    participants = (DiscoveredParticipant(GUID, 0), DiscoveredParticipant(OTHER, 0))
    assert discovered_graph(participants, (), {"0110a5a5": "/both"}).graph.subjects == ("/both",)


def test_a_name_that_is_made_up_is_warned_of() -> None:
    found = discovered_graph((DiscoveredParticipant(GUID, 7),), (), {})
    (said,) = found.diagnostics
    assert (said.code, said.severity) == ("subject-unknown", Severity.WARNING)
    assert GUID in said.message
    assert "--subject" in said.help


@pytest.mark.parametrize(("guid", "name"), [("talker", "/a"), ("0110", "/a"), ("0110a5a5", "a"), ("0110a5a5", "/../x")])
def test_what_the_user_cannot_say(guid: str, name: str) -> None:
    with pytest.raises(KeymintError) as caught:
        named(DiscoveredParticipant(GUID, 0), names={guid: name})
    assert caught.value.exit_code == 2


def test_what_no_name_can_hold_is_left_out_with_a_warning() -> None:
    odd = [DiscoveredEndpoint(GUID, "publish", name) for name in ("", "a\x01", "x" * 5000)]
    odd.append(DiscoveredEndpoint(GUID, "publish", "t", "", ("p\n",)))
    fine = DiscoveredEndpoint(GUID, "publish", "rt/fine", "T")
    found = discovered_graph((DiscoveredParticipant(GUID, 0, "a"),), (*odd, fine), {})
    assert [edge.object.name for edge in found.graph.edges] == ["rt/fine"]
    assert [said.code for said in found.diagnostics if said.severity is Severity.WARNING] == ["endpoint-odd"]


THIRD = "0110a5a5deadbeef00000003000001c1"


@pytest.mark.parametrize(
    ("first", "second", "names", "expected"),
    [
        (DiscoveredParticipant(GUID, 0, "talker"), DiscoveredParticipant(OTHER, 0, "talker"), {}, Severity.WARNING),
        (DiscoveredParticipant(GUID, 0, "talker"), DiscoveredParticipant(OTHER, 0, "/talker"), {}, Severity.WARNING),
        (
            DiscoveredParticipant(GUID, 0, "talker"),
            DiscoveredParticipant(OTHER, 0, "", b"name=talker;namespace=/;"),
            {},
            Severity.WARNING,
        ),
        (
            DiscoveredParticipant(GUID, 0, "", b"enclave=/a;"),
            DiscoveredParticipant(OTHER, 0, "", b"enclave=/a;"),
            {},
            Severity.NOTE,
        ),
        (DiscoveredParticipant(GUID, 0, "talker"), DiscoveredParticipant(OTHER, 0, "listener"), {}, None),
        (DiscoveredParticipant(GUID, 0, "talker"), DiscoveredParticipant(OTHER, 0, "talker"), {OTHER: "/other"}, None),
        (
            DiscoveredParticipant(GUID, 0, "talker"),
            DiscoveredParticipant(OTHER, 0, "talker"),
            {"0110a5a5": "/both"},
            None,
        ),
        (DiscoveredParticipant(GUID, 0, "talker"), DiscoveredParticipant(OTHER, 1, "talker"), {}, None),
    ],
)
def test_participants_that_are_merged_are_reported(
    first: DiscoveredParticipant, second: DiscoveredParticipant, names: dict[str, str], expected: Severity | None
) -> None:
    found = discovered_graph((first, second, DiscoveredParticipant(THIRD, 0, "alone")), (), names)
    merged = [each for each in found.diagnostics if each.code == "subject-shared"]
    assert [each.severity for each in merged] == ([] if expected is None else [expected])
    for each in merged:
        assert GUID in each.message
        assert OTHER in each.message
        assert "--subject" in each.help
