# SPDX-License-Identifier: Apache-2.0
"""The simulated transport on installed files."""

from __future__ import annotations

import json
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from keymint_ros2_zenoh.decision import AccessModel
from keymint_ros2_zenoh.transports import zenoh_1

from keymint.api import Environment, InstalledEnclave, Tier, Verdict
from keymint.api.graph import Edge, Object
from keymint.errors import KeymintError
from tests.plugins.keymint_ros2_zenoh.install_spaces import InstallSpace, key

CHATTER = Object("ros_topic", "/chatter")


def label(enclaves: list[InstalledEnclave], *edges: Edge, days: float = 0) -> list[Verdict]:
    environment = Environment(datetime.now(UTC) + timedelta(days=days), Path("/nowhere"))
    found = list(zenoh_1.open(environment).label(enclaves, iter(edges), Tier.DECISION))
    assert [edge for edge, _ in found] == list(edges)
    return [verdict for _, verdict in found]


@pytest.fixture
def space(tmp_path: Path) -> InstallSpace:
    return InstallSpace(
        tmp_path / "install",
        {"/talker": [("publish", key("chatter"))], "/listener": [("subscribe", key("chatter"))]},
    )


PUBLISH = Edge("/talker", "ros_publish", CHATTER)


def test_edges_are_decided_by_the_routers_file_which_the_verdict_names(space: InstallSpace) -> None:
    listen = Edge("/listener", "ros_subscribe", CHATTER)
    found = label(space.write(), PUBLISH, Edge("/talker", "ros_subscribe", CHATTER), listen)
    assert [each.allowed for each in found] == [True, False, True]
    router = space.folder / "zenoh/router.json5"
    where = found[0].where
    assert where is not None
    assert where.file == str(router)
    assert "'/talker 0.0'" in found[0].reason
    assert '"id": "/talker 0.0"' in "".join(router.read_text().splitlines()[where.line - 1 : where.line + 2])


def test_the_rights_of_all_enclaves_are_read_once_although_each_enclave_is_asked_by_itself(
    space: InstallSpace, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = []
    monkeypatch.setattr(
        "keymint_ros2_zenoh.transports.enclave_model.AccessModel",
        lambda control: made.append(control) or AccessModel(control),
    )
    transport = zenoh_1.open(Environment(datetime.now(UTC), Path("/nowhere")))
    for enclave in space.write():
        list(transport.label([enclave], [Edge(enclave.subject, "ros_publish", CHATTER)], Tier.DECISION))
    assert len(made) == 1 + len(space.write())


def test_another_domain_is_denied(space: InstallSpace) -> None:
    assert not label(space.write(), Edge("/talker", "ros_publish", CHATTER, 1))[0].allowed


@pytest.mark.parametrize("left_out", ["put", "reply"])
def test_every_message_is_needed(space: InstallSpace, left_out: str) -> None:
    enclaves = space.write()
    file = space.folder / "zenoh/router.json5"
    document = json.loads(file.read_text())
    first = document["access_control"]["rules"][0]
    first["messages"].remove(left_out)
    file.write_text(json.dumps(document))
    [found] = label(enclaves, PUBLISH)
    assert not found.allowed
    assert f"{left_out} in on 0/chatter/" in found.reason
    assert found.partial  # a bare put is a way to publish, and so is the reply of a cache


def rights(messages: list[str], flows: list[str], expression: str) -> dict[str, object]:
    return {"id": "more", "permission": "allow", "messages": messages, "flows": flows, "key_exprs": [expression]}


@pytest.mark.parametrize(
    ("subject", "edge", "rules"),
    [
        ("/listener", "ros_publish", [rights(["put"], ["ingress"], "0/chatter/*/*")]),
        (
            "/listener",
            "ros_publish",
            [
                rights(["reply"], ["ingress"], "0/chatter/*/*"),
                {**rights(["query"], ["egress"], "0/chatter/*/*/@adv/**"), "id": "beside"},
                {**rights(["declare_queryable"], ["ingress"], "0/chatter/*/*/@adv/**"), "id": "answers"},
            ],
        ),
        (
            "/talker",
            "ros_subscribe",
            [
                rights(["query"], ["ingress"], "0/chatter/*/*/@adv/**"),
                {**rights(["reply"], ["egress"], "0/chatter/*/*"), "id": "cached"},
            ],
        ),
        ("/talker", "ros_call", [rights(["query"], ["ingress"], "0/asked/*/*")]),
        (
            "/talker",
            "ros_execute",
            [
                rights(["query"], ["egress"], "0/asked/*/*"),
                {**rights(["declare_queryable"], ["ingress"], "0/asked/*/*"), "id": "served"},
            ],
        ),
    ],
)
def test_a_way_around_what_ros_needs_is_a_partial_permission(
    space: InstallSpace, subject: str, edge: str, rules: list[dict[str, object]]
) -> None:
    enclaves = space.write()
    file = space.folder / "zenoh/router.json5"
    document = json.loads(file.read_text())
    control = document["access_control"]
    policy = next(each for each in control["policies"] if subject in each["subjects"][0])
    is_topic = edge in {"ros_publish", "ros_subscribe"}
    wanted = Edge(subject, edge, CHATTER if is_topic else Object("ros_service", "/asked"))
    for length in range(len(rules) + 1):
        file.write_text(
            json.dumps(
                document
                | {
                    "access_control": control
                    | {
                        "rules": control["rules"] + rules[:length],
                        "policies": [
                            each | {"rules": each["rules"] + [rule["id"] for rule in rules[:length]]}
                            if each is policy
                            else each
                            for each in control["policies"]
                        ],
                    }
                }
            )
        )
        [found] = label(enclaves, wanted)
        assert (found.allowed, found.partial) == (False, length == len(rules))


def test_the_sessions_own_access_control_decides_as_well(space: InstallSpace) -> None:
    space.changes["/talker"] = {"access_control": {"policies": [], "rules": [], "subjects": []}}
    [found] = label(space.write(), PUBLISH)
    assert (found.allowed, found.where is not None and found.where.file.endswith("talker/session.json5")) == (
        False,
        True,
    )


def test_a_name_in_another_case_has_no_rights(space: InstallSpace) -> None:
    space.names["/talker"] = "/Talker"
    enclaves = space.write()
    assert label(enclaves, PUBLISH)[0].allowed  # the router's file names the certificate
    file = space.folder / "zenoh/router.json5"
    file.write_text(file.read_text().replace('"/Talker"', '"/talker"'))
    assert not label(enclaves, PUBLISH)[0].allowed


def test_an_expired_certificate_denies_everything_and_says_so(space: InstallSpace) -> None:
    [found] = label(space.write(), PUBLISH, days=30)
    assert not found.allowed
    assert "expired" in found.reason


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"connect": {"endpoints": ["tls/localhost:1"]}}, "does not connect to a port of the router"),
        ({"connect": {"endpoints": ["tls/robot.local:7447"]}}, "subjectAltName"),
    ],
)
def test_a_session_that_cannot_reach_the_router_is_refused(space: InstallSpace, changes, reason: str) -> None:
    space.changes["/talker"] = changes
    [found] = label(space.write(), PUBLISH)
    assert not found.allowed
    assert reason in found.reason


def test_a_session_with_the_files_of_another_enclave_has_that_enclaves_rights(space: InstallSpace) -> None:
    stolen = "/robot/keystore/enclaves/listener"
    paths = {"connect_certificate": f"{stolen}/cert.pem", "connect_private_key": f"{stolen}/key.pem"}
    space.changes["/talker"] = {"transport": {"link": {"tls": paths}}}
    found = label(space.write(), PUBLISH, Edge("/talker", "ros_subscribe", CHATTER))
    assert [each.allowed for each in found] == [False, True]


@pytest.mark.parametrize("file", ["zenoh/router.json5", "enclaves/talker/session.json5", "enclaves/talker/cert.pem"])
def test_a_missing_file_is_an_error_with_its_path(space: InstallSpace, file: str) -> None:
    enclaves = space.write()
    (space.folder / file).unlink()
    with pytest.raises(KeymintError, match="run 'keymint install'") as raised:
        label(enclaves, PUBLISH)
    assert raised.value.diagnostics[0].code == "enclave-file"


def test_a_file_that_zenoh_refuses_is_an_error(space: InstallSpace) -> None:
    space.changes[""] = {"access_control": {"default_permission": "maybe"}}
    enclaves = space.write()
    with pytest.raises(KeymintError, match=r"router\.json5:\d+"):
        label(enclaves, PUBLISH)
