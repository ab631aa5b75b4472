# SPDX-License-Identifier: Apache-2.0
"""The real transport ``zenoh``, as ``keymint verify`` uses it, compared with its model."""

from __future__ import annotations

import importlib.util
import os
from datetime import UTC, datetime
from pathlib import Path

import pytest
from keymint_ros2_zenoh.transports import real_zenoh, zenoh_1

from keymint.api import Environment, InstalledEnclave, Tier, Verdict
from keymint.api.graph import Edge, Object
from keymint.errors import KeymintError
from tests.plugins.keymint_ros2_zenoh.install_spaces import ROUTER, InstallSpace, key

pytestmark = pytest.mark.zenoh

TOPIC, SERVICE = "ros_topic", "ros_service"
REQUESTS = (
    ("ros_publish", Object(TOPIC, "/chatter")),
    ("ros_subscribe", Object(TOPIC, "/chatter")),
    ("ros_call", Object(SERVICE, "/add")),
    ("ros_execute", Object(SERVICE, "/add")),
    ("ros_publish", Object(TOPIC, "/wide/x")),
    ("ros_subscribe", Object(TOPIC, "/wide/x")),
    ("ros_publish", Object(TOPIC, "/wide/secret/x")),
    ("ros_call", Object(SERVICE, "/chatter")),
    ("ros_publish", Object(TOPIC, "/a*")),
)


@pytest.fixture
def environment(tmp_path: Path) -> Environment:
    return Environment(datetime.now(UTC), tmp_path / "cache", dict(os.environ))


@pytest.fixture
def space(tmp_path: Path) -> InstallSpace:
    """A talker, a listener, and an enclave without rights."""
    talker = [("publish", key("chatter")), ("call", key("add")), ("publish", "0/wide/**"), ("deny", "0/wide/secret/**")]
    listener = [("subscribe", key("chatter")), ("execute", key("add")), ("subscribe", "0/wide/**")]
    rights = {"/listener": listener, "/ns/nobody": [], "/talker": talker}
    return InstallSpace(tmp_path / "install", rights)


def labelled(opened, enclaves: list[InstalledEnclave], tier: Tier, *edges: Edge) -> list[Verdict]:
    found = list(opened.label(enclaves, iter(edges), tier))
    assert [edge for edge, _ in found] == list(edges)
    return [verdict for _, verdict in found]


def edges_of(*subjects: str) -> list[Edge]:
    return [Edge(subject, permission, name) for subject in subjects for permission, name in REQUESTS]


@pytest.mark.parametrize("tier", list(Tier))
def test_all_tiers_and_the_model_make_the_same_decisions(
    zenoh_library: str, space: InstallSpace, environment: Environment, tier: Tier
) -> None:
    enclaves = space.write()
    edges = edges_of("/listener", "/ns/nobody", "/talker")
    modelled = labelled(zenoh_1.open(environment), enclaves, Tier.DECISION, *edges)
    found = labelled(real_zenoh.open(environment), enclaves, tier, *edges)
    assert [verdict.allowed for verdict in found] == [verdict.allowed for verdict in modelled]
    assert [str(edge.object.name) for edge, verdict in zip(edges, found, strict=True) if verdict.allowed] == [
        "/chatter", "/add", "/wide/x", "/chatter", "/add", "/wide/x",
    ]  # fmt: skip
    assert all(verdict.reason for verdict in found)
    assert all(verdict.where for verdict in found if verdict.allowed)


def test_data_is_delivered_and_an_attacker_reaches_nobody(
    zenoh_library: str, space: InstallSpace, environment: Environment
) -> None:
    found = labelled(
        real_zenoh.open(environment),
        space.write(),
        Tier.EXCHANGE,
        Edge("/ns/nobody", "ros_publish", Object(TOPIC, "/chatter")),
        Edge("/talker", "ros_publish", Object(TOPIC, "/chatter")),
        Edge("/talker", "ros_publish", Object(TOPIC, "/wide/secret/x")),
    )
    assert found[0].reason.endswith("nothing reached /listener")
    assert found[1].reason == "data was delivered with /listener"
    assert found[2].reason.endswith("nothing reached /listener")


def test_exchange_finds_a_put_that_is_permitted_alone(
    zenoh_library: str, space: InstallSpace, environment: Environment
) -> None:
    """A right that lacks messages is no right of a node, but an attacker needs no more than the put."""
    space.changes[""] = {"access_control": _with_rule(space, "/ns/nobody", ["put"])}
    enclaves, edge = space.write(), Edge("/ns/nobody", "ros_publish", Object(TOPIC, "/chatter"))
    opened = real_zenoh.open(environment)
    [logged] = labelled(opened, enclaves, Tier.DECISION, edge)
    [exchanged] = labelled(opened, enclaves, Tier.EXCHANGE, edge)
    assert (logged.allowed, exchanged.allowed) == (False, True)
    assert "ignores its own access control" in exchanged.reason


def _with_rule(space: InstallSpace, subject: str, messages: list[str]) -> dict[str, object]:
    control = space.router()["access_control"]
    rule = {"id": "more", "messages": messages, "flows": ["ingress"], "permission": "allow", "key_exprs": ["0/**"]}
    policies = [*control["policies"], {"rules": ["more"], "subjects": [subject]}]
    return {"rules": [*control["rules"], rule], "policies": policies}


@pytest.mark.parametrize("tier", [Tier.DECISION, Tier.EXCHANGE])
def test_a_refused_session_denies_every_edge_and_reports_the_reason(
    zenoh_library: str, space: InstallSpace, environment: Environment, tier: Tier
) -> None:
    space.lives["/talker"] = -60.0
    [found] = labelled(real_zenoh.open(environment), space.write(), tier, edges_of("/talker")[0])
    assert not found.allowed
    assert "expired" in found.reason
    assert found.where is not None
    assert found.where.file.endswith("talker/session.json5")


def test_a_certificate_that_no_subject_names_has_no_rights(
    zenoh_library: str, space: InstallSpace, environment: Environment
) -> None:
    enclaves = space.write()
    space.enclave("talker", "/Talker")
    found = labelled(real_zenoh.open(environment), enclaves, Tier.DECISION, *edges_of("/talker"))
    assert not any(verdict.allowed for verdict in found)


@pytest.mark.parametrize("host", ["robot.local", "other.local"])
def test_a_router_on_another_host_is_tried_here_if_its_certificate_names_that_host(
    zenoh_library: str, space: InstallSpace, environment: Environment, host: str
) -> None:
    for subject in space.rights:
        space.changes[subject] = {"connect": {"endpoints": ["tls/robot.local:7447"]}}
    enclaves, edge = space.write(), edges_of("/talker")[0]
    space.enclave(ROUTER, ROUTER, server=True, host=host)
    for opened in (zenoh_1.open(environment), real_zenoh.open(environment)):
        [found] = labelled(opened, enclaves, Tier.DECISION, edge)
        assert found.allowed == (host == "robot.local")
        assert found.allowed or "subjectAltName" in found.reason


def test_a_router_without_access_control_allows_everything_that_sessions_do(
    zenoh_library: str, space: InstallSpace, environment: Environment
) -> None:
    space.changes[""] = {"access_control": {"enabled": False}}
    enclaves, edges = space.write(), edges_of("/ns/nobody")[:4]
    for opened in (zenoh_1.open(environment), real_zenoh.open(environment)):
        assert all(verdict.allowed for verdict in labelled(opened, enclaves, Tier.DECISION, *edges))


def test_a_router_that_zenoh_does_not_start_is_an_error(
    zenoh_library: str, space: InstallSpace, environment: Environment
) -> None:
    enclaves = space.write()
    (space.folder / "enclaves/zenoh_router/key.pem").write_text("no key")
    with pytest.raises(KeymintError, match="Zenoh does not start the router") as raised:
        labelled(real_zenoh.open(environment), enclaves, Tier.DECISION, edges_of("/talker")[0])
    assert raised.value.diagnostics[0].code == "enclave-refused"


def test_the_library_prints_nothing_on_our_standard_output(
    zenoh_library: str, space: InstallSpace, environment: Environment, capfd: pytest.CaptureFixture
) -> None:
    labelled(real_zenoh.open(environment), space.write(), Tier.DECISION, edges_of("/talker")[0])
    assert capfd.readouterr().out == ""


def test_without_the_library_the_transport_reports_how_to_install_it(
    environment: Environment, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    opened = real_zenoh.open(environment)
    usable = opened.usable()
    assert (usable.usable, usable.tiers) == (False, ())
    assert "pip install eclipse-zenoh" in usable.help
    with pytest.raises(KeymintError, match="cannot be used at tier decision: no library eclipse-zenoh"):
        list(opened.label([], [], Tier.DECISION))
