# SPDX-License-Identifier: Apache-2.0
"""Simulated transports on installed enclaves: every file counts, and a refusal says why."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import timedelta
from pathlib import Path

import pytest
from keymint_ros2_dds.transports import cyclonedds_0_10, fastdds_2_9, omg

from keymint.api import Environment, InstalledEnclave, Tier, Verdict
from keymint.api.graph import Column, Edge, Graph, Object, complete
from keymint.errors import KeymintError
from keymint.pki import smime

from ..enclaves import NOW, authority, installed  # noqa: TID252 - helpers of the folder above
from ..packages import package, rule  # noqa: TID252 - helpers of the folder above

OPENERS = {"omg": omg, "cyclonedds-0.10": cyclonedds_0_10, "fastdds-2.9": fastdds_2_9}
CHATTER = Object("ros_topic", "/chatter")
SERVICE = Object("ros_service", "/add")
SUBJECT = "/talker"


@pytest.fixture(params=OPENERS)
def name(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture(scope="module")
def files() -> Mapping[str, bytes]:
    loaded = package(
        rule("ALLOW", "ros_topic", "ros_publish", "/chatter"),
        rule("ALLOW", "ros_service", "ros_call", "/add"),
        rule("ALLOW", "topic", "publish", "raw", partitions=("p",)),
    )
    return installed(loaded)


def verdicts(name: str, folder: Path, files: Mapping[str, bytes], *edges: Edge, now=NOW) -> list[Verdict]:
    folder.mkdir(exist_ok=True)
    for file, content in files.items():
        (folder / file).write_bytes(content)
    transport = OPENERS[name].open(Environment(now, folder / "no-cache"))
    assert transport.usable().tiers == (Tier.DECISION,)
    enclaves = [InstalledEnclave(SUBJECT, folder, "humble", folder.parent)]
    found = list(transport.label(enclaves, iter(edges), Tier.DECISION))
    assert [edge for edge, _ in found] == list(edges)
    return [verdict for _, verdict in found]


def edge(permission: str, found: Object = CHATTER, domain: int = 0) -> Edge:
    return Edge(SUBJECT, permission, found, domain)


def test_edges_are_decided_by_all_their_endpoints(name: str, tmp_path: Path, files: Mapping[str, bytes]) -> None:
    raw = [Object("topic", "raw", partitions) for partitions in ((), ("p",), ("p", "q"))]
    edges = [
        edge("ros_publish"),
        edge("ros_subscribe"),
        edge("ros_call", SERVICE),
        edge("ros_execute", SERVICE),
        *(edge("publish", each) for each in raw),
    ]
    found = verdicts(name, tmp_path, files, *edges)
    assert [verdict.allowed for verdict in found] == [True, False, True, False, False, True, False]
    assert all(
        verdict.reason.startswith(("the allow_rule", "no rule matches")) and verdict.where.line for verdict in found
    )
    assert not any(verdict.deviation for verdict in found)


def altered(files: Mapping[str, bytes], old: bytes, new: bytes, file: str = "permissions") -> dict[str, bytes]:
    """Sign another document, as an authority that was asked to."""
    content = smime.signed_content(files[f"{file}.p7s"])
    assert old in content
    ca = authority("permissions_ca")
    return {**files, f"{file}.p7s": smime.sign(content.replace(old, new), ca.certificate, ca.key)}


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        (b"<subject_name>CN=/talker", b"<subject_name>CN=/listener", "no grant applies to"),
        (b"<not_after>2", b"<not_after>1", "has expired"),
        (b"<topic>rt/chatter", b"<topic>rt/chatty", "no rule matches 'rt/chatter'"),
    ],
)
def test_an_edited_document_is_decided_by(
    name: str, tmp_path: Path, files: Mapping[str, bytes], old: bytes, new: bytes, reason: str
) -> None:
    [found] = verdicts(name, tmp_path, altered(files, old, new), edge("ros_publish"))
    assert (found.allowed, reason in found.reason) == (False, True), found


def test_access_that_governance_does_not_control_is_allowed(
    name: str, tmp_path: Path, files: Mapping[str, bytes]
) -> None:
    content = altered(files, b"<enable_read_access_control>true", b"<enable_read_access_control>false", "governance")
    found = verdicts(name, tmp_path, content, edge("ros_subscribe"), edge("ros_publish", Object("ros_topic", "/x")))
    assert [verdict.allowed for verdict in found] == [True, False]
    assert found[0].reason.startswith("governance.xml:")
    assert found[0].where.line == 0, "no rule of the permissions decides"


def test_a_domain_that_governance_does_not_name_is_denied(
    name: str, tmp_path: Path, files: Mapping[str, bytes]
) -> None:
    [found] = verdicts(name, tmp_path, files, edge("ros_publish", domain=9))
    assert not found.allowed


def test_a_signature_that_does_not_hold_denies(name: str, tmp_path: Path, files: Mapping[str, bytes]) -> None:
    broken = {**files, "permissions.p7s": files["permissions.p7s"].replace(b"rt/chatter", b"rt/chattez")}
    [found] = verdicts(name, tmp_path, broken, edge("ros_publish"))
    assert (found.allowed, "permissions.p7s" in found.reason) == (False, True)
    foreign = {**files, "permissions_ca.cert.pem": authority("other").pem}
    assert not verdicts(name, tmp_path, foreign, edge("ros_publish"))[0].allowed


@pytest.mark.parametrize("file", ["permissions.p7s", "governance.p7s", "cert.pem", "permissions_ca.cert.pem"])
def test_a_missing_file_denies_and_is_named(name: str, tmp_path: Path, files: Mapping[str, bytes], file: str) -> None:
    left = {other: content for other, content in files.items() if other != file}
    [found] = verdicts(name, tmp_path, left, edge("ros_publish"))
    assert not found.allowed
    assert file in found.reason or file == "permissions_ca.cert.pem"


def test_time_is_that_of_the_surroundings(name: str, tmp_path: Path, files: Mapping[str, bytes]) -> None:
    [found] = verdicts(name, tmp_path, files, edge("ros_publish"), now=NOW + timedelta(days=9999))
    assert not found.allowed


def test_a_subject_without_an_enclave_is_an_error(name: str, tmp_path: Path) -> None:
    transport = OPENERS[name].open(Environment(NOW, tmp_path))
    with pytest.raises(KeymintError, match="/talker has no installed enclave"):
        list(transport.label([], [edge("ros_publish")], Tier.DECISION))


def test_a_difference_from_the_standard_names_its_row(tmp_path: Path, files: Mapping[str, bytes]) -> None:
    deny_first = altered(
        files,
        b"<allow_rule>",
        b"<deny_rule><domains><id>0</id></domains><subscribe><topics><topic>rt/chatter</topic></topics></subscribe>"
        b"</deny_rule><allow_rule>",
    )
    [found] = verdicts("cyclonedds-0.10", tmp_path, deny_first, edge("ros_publish"))
    assert not found.allowed
    assert found.deviation.startswith("row 9, topic-check: ")
    assert not verdicts("fastdds-2.9", tmp_path, deny_first, edge("ros_publish"))[0].deviation


def test_memory_is_that_of_one_subject(tmp_path: Path, files: Mapping[str, bytes]) -> None:
    """Edges are consumed as their verdicts are taken."""
    (tmp_path / "e").mkdir()
    for file, content in files.items():
        (tmp_path / "e" / file).write_bytes(content)
    taken = 0

    def edges():
        nonlocal taken
        for each in complete(Graph.of([edge("ros_publish", Object("ros_topic", f"/t{n}")) for n in range(50)])):
            taken += 1
            yield each

    labelled = omg.open(Environment(NOW, tmp_path)).label(
        [InstalledEnclave(SUBJECT, tmp_path / "e", "humble", tmp_path)], edges(), Tier.DECISION
    )
    next(labelled)
    assert taken == 1


def test_transports_of_a_run_read_the_documents_of_an_enclave_once(tmp_path: Path, files: Mapping[str, bytes]) -> None:
    environment = Environment(NOW, tmp_path)
    for folder in (tmp_path / "one", tmp_path / "two"):
        folder.mkdir()
        for file, content in files.items():
            (folder / file).write_bytes(content)
        for opener in OPENERS.values():
            list(
                opener.open(environment).label(
                    [InstalledEnclave(SUBJECT, folder, "humble", tmp_path)], [edge("ros_publish")], Tier.DECISION
                )
            )
    assert len(environment.opened) == 1
    (tmp_path / "one/permissions.p7s").write_bytes(files["governance.p7s"])
    transport = omg.open(environment)
    ((_, verdict),) = transport.label(
        [InstalledEnclave(SUBJECT, tmp_path / "one", "humble", tmp_path)], [edge("ros_publish")], Tier.DECISION
    )
    assert not verdict.allowed, "other files are read again"


@pytest.mark.parametrize("days", [0, 9999])
@pytest.mark.parametrize("broken", ["", "cert.pem"])
def test_many_endpoints_are_decided_as_one_by_one(
    name: str, tmp_path: Path, files: Mapping[str, bytes], days: int, broken: str
) -> None:
    topics = [("rt/chatter", ()), ("raw", ()), ("raw", ("p",)), ("raw", ("p", "q")), ("rq/addRequest", ()), ("x", ())]
    asked = [
        Edge(SUBJECT, action, Object("topic", topic, partitions), domain)
        for topic, partitions in topics
        for action in ("publish", "subscribe")
        for domain in (0, 1)
    ]
    now = NOW + timedelta(days=days)
    written = {file: content for file, content in files.items() if file != broken}
    for edges in (asked, [each for each in asked if each.domain == 0]):
        one_by_one = [verdict.allowed for verdict in verdicts(name, tmp_path / "talker", written, *edges, now=now)]
        transport = OPENERS[name].open(Environment(now, tmp_path / "no-cache"))
        enclave = InstalledEnclave(SUBJECT, tmp_path / "talker", "humble", tmp_path)
        assert transport.admitted(enclave, Column(tuple(edges)), Tier.DECISION) == bytes(one_by_one)
        assert any(one_by_one) == (not days and not broken)
