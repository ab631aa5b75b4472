# SPDX-License-Identifier: Apache-2.0
"""The real transports, as ``keymint verify`` uses them, compared with their models."""

from __future__ import annotations

import ctypes
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import pytest
from keymint_ros2_dds.transports import real_cyclonedds
from keymint_ros2_dds.transports.enclave_model import Simulated
from keymint_ros2_dds.transports.real_transports import ParticipantsTransport
from keymint_ros2_dds.vendors.participants import System

from keymint.api import Environment, InstalledEnclave, Tier, Transport, Verdict
from keymint.api.graph import Column, Edge, Object
from keymint.errors import KeymintError
from keymint.pki import smime
from tests.effort import tries

from .conftest import CYCLONEDDS, REAL_TRANSPORTS, TRANSPORTS, environment, usable_transport, variation
from .handmade import Authorities, criteria, governance_document, permissions_document, rule
from .model_agreement import disagreements

X, Y, Z = (Object("topic", f"rt/{name}") for name in "xyz")


@pytest.fixture(params=REAL_TRANSPORTS)
def vendor_name(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture
def transport(vendor_name: str) -> Transport:
    return usable_transport(vendor_name)


@pytest.fixture
def model(vendor_name: str) -> Transport:
    return Simulated(variation(TRANSPORTS[vendor_name][1]).name, environment())


def enclave(authorities: Authorities, folder: Path, rules: str = "", **more: str) -> Path:
    """Write an enclave whose documents have the form that Keymint writes."""
    name, ca = more.get("name", "/talker"), authorities.permissions
    authorities.enclave(folder, rules, **more)
    documents = {
        "permissions.p7s": more.get("permissions") or permissions_document(f"CN={name}", rules),
        "governance.p7s": more.get("governance") or governance_document(),
    }
    for file, content in documents.items():
        (folder / file).write_bytes(smime.sign(content.encode(), ca.certificate, ca.key))
    return folder


@pytest.fixture
def pair(authorities: Authorities, tmp_path: Path) -> list[InstalledEnclave]:
    """A talker that may publish x and z, and a listener that may do everything."""
    publish, everything = (criteria("publish", ["rt/x", "rt/z"]), criteria("publish", ["*"]))
    folders = {
        "/talker": enclave(authorities, tmp_path / "talker", rule("allow", publish), name="/talker"),
        "/listener": enclave(
            authorities,
            tmp_path / "listener",
            rule("allow", everything + criteria("subscribe", ["*"])),
            name="/listener",
        ),
    }
    return [InstalledEnclave(subject, folder, "humble", folder.parent) for subject, folder in folders.items()]


def labelled(transport: Transport, enclaves: list[InstalledEnclave], tier: Tier, *edges: Edge) -> list[Verdict]:
    found = list(transport.label(enclaves, iter(edges), tier))
    assert [edge for edge, _ in found] == list(edges)
    return [verdict for _, verdict in found]


def talker(permission: str, found: Object, domain: int = 0) -> Edge:
    return Edge("/talker", permission, found, domain)


EDGES = (talker("publish", X), talker("subscribe", X), talker("publish", Y), talker("publish", Z))


@pytest.mark.parametrize("tier", list(Tier))
def test_all_tiers_make_the_same_decisions(transport: Transport, pair: list[InstalledEnclave], tier: Tier) -> None:
    found = labelled(transport, pair, tier, *EDGES, Edge("/listener", "publish", Y))
    assert [verdict.allowed for verdict in found] == [True, False, False, True, True]
    assert all(verdict.reason for verdict in found)
    assert found[0].where.line


@pytest.mark.parametrize("tier", [Tier.DECISION, Tier.ADMISSION])
def test_many_endpoints_are_decided_as_one_by_one(
    transport: Transport, pair: list[InstalledEnclave], tier: Tier
) -> None:
    assert transport.ADMITS
    unsayable = talker("publish", Object("topic", "a\tb"))
    asked = [*EDGES, unsayable, *(talker("publish", Object("topic", f"rt/{n}")) for n in range(70)), *EDGES]
    asked += [replace(each, domain=1) for each in EDGES]
    expected = [verdict.allowed for verdict in labelled(transport, pair, tier, *sorted(asked, key=by_domain))]
    admitted = transport.admitted(pair[0], Column(tuple(sorted(asked, key=by_domain))), tier)
    assert admitted == bytes(expected)
    assert sum(admitted) >= 4


def by_domain(edge: Edge) -> int:
    return edge.domain


def test_allowed_samples_are_delivered_and_an_intruder_is_refused(
    transport: Transport, pair: list[InstalledEnclave]
) -> None:
    found = labelled(transport, pair, Tier.EXCHANGE, *EDGES)
    assert found[0].reason == "a sample was delivered with /listener"
    assert all(found[index].reason.endswith("; /listener refuses it as well") for index in (1, 2))


def test_a_participant_that_does_not_conform_ignores_its_own_permissions(
    transport: ParticipantsTransport, pair: list[InstalledEnclave]
) -> None:
    """Else its refusal, which the tier *exchange* reports, would be by its own side."""
    with System(transport._vendor(nonconforming=True)) as system:
        listener = system.open(pair[1].folder)
        talker = system.open(pair[0].folder, conforming=False)
        readers = [listener.edge("subscribe", topic.name) for topic in (Y, X)]
        for topic in (Y, X):
            talker.edge("publish", topic.name).write("hello")
        assert readers[1].read(10.0) == "hello"
        assert readers[0].read(0.5) is None


def test_samples_are_exchanged_within_a_partition(
    authorities: Authorities, transport: Transport, tmp_path: Path
) -> None:
    both = criteria("publish", ["rt/x"], ["a"]) + criteria("subscribe", ["rt/x"], ["a"])
    enclaves = [
        InstalledEnclave(
            f"/{name}", enclave(authorities, tmp_path / name, rule("allow", both), name=f"/{name}"), "humble", tmp_path
        )
        for name in ("talker", "listener")
    ]
    places = [Object("topic", "rt/x", partitions) for partitions in (("a",), ("b",), ())]
    found = labelled(transport, enclaves, Tier.EXCHANGE, *(talker("publish", place) for place in places))
    assert [verdict.allowed for verdict in found] == [True, False, False]
    assert "delivered" in found[0].reason
    assert "nothing was sent" in found[1].reason


@pytest.mark.parametrize("tier", list(Tier))
def test_a_refused_enclave_denies_every_edge_and_reports_the_reason(
    authorities: Authorities, transport: Transport, tmp_path: Path, tier: Tier
) -> None:
    content = permissions_document("CN=/somebody", rule("allow", criteria("publish", ["rt/x"])))
    folder = enclave(authorities, tmp_path, name="/talker", permissions=content)
    [found] = labelled(
        transport, [InstalledEnclave("/talker", folder, "humble", folder.parent)], tier, talker("publish", X)
    )
    assert not found.allowed
    assert "refuse" in found.reason


def test_domains_are_decided_separately(authorities: Authorities, transport: Transport, tmp_path: Path) -> None:
    wide = governance_document(domains="<id_range><min>0</min><max>9</max></id_range>")
    folder = enclave(authorities, tmp_path, rule("allow", criteria("publish", ["rt/x"])), governance=wide)
    edges = [talker("publish", X, domain) for domain in (0, 1)]
    found = labelled(transport, [InstalledEnclave("/talker", folder, "humble", folder.parent)], Tier.DECISION, *edges)
    assert found[0].allowed
    assert found[1].allowed == found[1].deviation.startswith("row 10, domains-unused")


@pytest.mark.parametrize("tier", [Tier.DECISION, Tier.ADMISSION])
@pytest.mark.parametrize("vendor_name", CYCLONEDDS, indirect=True)
def test_a_document_that_crashes_cyclone_dds_is_not_given_to_it(
    authorities: Authorities, transport: Transport, tmp_path: Path, tier: Tier
) -> None:
    crashing = rule("allow", criteria("publish", ["rt/x"])).replace("<id>0</id>", "<id_range><max>3</max></id_range>")
    folder = enclave(authorities, tmp_path, crashing)
    [found] = labelled(
        transport, [InstalledEnclave("/talker", folder, "humble", folder.parent)], tier, talker("publish", X)
    )
    assert (found.allowed, "crashes Cyclone DDS" in found.reason) == (False, True)


@pytest.mark.cyclonedds
def test_cyclone_dds_prints_nothing_on_our_standard_output(
    authorities: Authorities,
    cyclone_plugins: None,
    tmp_path: Path,
    capfd: pytest.CaptureFixture,
) -> None:
    """Its parser prints for each document that it refuses, which would corrupt the output of ``--json``."""
    folder = enclave(authorities, tmp_path, rule("allow", criteria("publish", ["rt/x"]), domain=231))
    opened = real_cyclonedds.open(environment())
    [found] = labelled(
        opened, [InstalledEnclave("/talker", folder, "humble", folder.parent)], Tier.DECISION, talker("publish", X)
    )
    ctypes.CDLL(None).fflush(None)
    assert not found.allowed
    assert capfd.readouterr().out == ""


def test_names_that_no_topic_can_have_are_denied(transport: Transport, pair: list[InstalledEnclave]) -> None:
    edges = [talker("publish", Object("topic", name)) for name in ("", "a\tb", "a\nb")]
    assert not any(verdict.allowed for verdict in labelled(transport, pair, Tier.ADMISSION, *edges))


@pytest.mark.parametrize("vendor_name", ["cyclonedds", "fastdds"])
def test_without_compiler_and_library_a_transport_reports_how_to_install_it(
    vendor_name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from keymint_ros2_dds.vendors import cyclone_access_control

    def absent() -> None:
        raise OSError("libddsc.so: cannot open shared object file")

    monkeypatch.setattr(cyclone_access_control, "library", absent)
    nowhere = Environment(datetime.now(UTC), tmp_path, {"PATH": str(tmp_path)})
    opened = TRANSPORTS[vendor_name][0].open(nowhere)
    usable = opened.usable()
    assert (usable.usable, usable.tiers) == (False, ())
    assert usable.help.startswith("apt-get install ")
    with pytest.raises(KeymintError, match="cannot be used at tier decision"):
        opened.label([], [], Tier.DECISION)


def test_models_agree_on_random_documents(transport: Transport, model: Transport, vendor_name: str) -> None:
    documents, requests = tries(100 if vendor_name == "cyclonedds" else 25, 400), 40
    compared = list(disagreements(transport, model, documents, requests, seed=2018))
    assert len(compared) == documents * requests
    assert [text for _, text in compared if text] == []
    assert any(allowed for allowed, _ in compared)
