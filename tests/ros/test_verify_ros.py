# SPDX-License-Identifier: Apache-2.0
"""``keymint verify --ros`` tells what is wrong with a keystore: six faults, each seeded into one that was right."""

from __future__ import annotations

import json
import shutil
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

from .ros_system import PAIR, RosSystem, rule

PUBLISHES = rule("ros_topic", "/chatter", "ros_publish")
LESS = PAIR.replace(PUBLISHES, rule("ros_topic", "/other", "ros_publish"))
assert LESS != PAIR


def verified(ros: RosSystem, code: int) -> dict[str, Any]:
    """Run ``verify --ros``; return its report."""
    report: dict[str, Any] = json.loads(ros.keymint("verify", "-w", ros.folder / "ws", "--ros", "--json", code=code))
    return report


def wrong(report: dict[str, Any]) -> Counter[tuple[str, str, str]]:
    """Return the mismatches: error, subject and permission."""
    found = report["result"]["transports"][0]["findings"]
    return Counter((each["error"], each["edge"]["subject"], each["edge"]["permission"]) for each in found)


def said(report: dict[str, Any]) -> str:
    """Return all words of ROS for denials."""
    return "\n".join(each["text"] for each in report["result"]["denials"])


def in_force(ros: RosSystem, text: str) -> None:
    """Change the policy of the workspace, which is not built."""
    (ros.folder / "ws.xml").write_text(text)


@pytest.fixture
def install(ros: RosSystem) -> Path:
    return ros.provision(PAIR)


def test_a_keystore_that_is_right(ros: RosSystem, install: Path) -> None:
    report = verified(ros, 0)
    assert not wrong(report)
    rows = {each["permission"]: each for each in report["result"]["operations"]}
    assert {"ros_publish", "ros_subscribe"} <= rows.keys()
    assert all(each["asked"] == each["agreed"] == each["denied"] + 1 for each in rows.values())
    shown = ros.keymint("verify", "-w", ros.folder / "ws", "--ros")
    assert "no mismatches between policy and transports" in shown
    assert "ROS SAID" in shown
    row = rows["ros_publish"]
    [line] = [line.split() for line in shown.splitlines() if line.startswith("ros_publish")]
    assert line[1:] == [str(row[each]) for each in ("asked", "agreed", "denied")]


def test_a_right_too_many(ros: RosSystem, install: Path) -> None:
    in_force(ros, LESS)
    assert ("false-positive", "/talker", "ros_publish") in wrong(verified(ros, 3))


def test_a_right_too_few(ros: RosSystem, install: Path) -> None:
    in_force(ros, PAIR.replace(PUBLISHES, PUBLISHES + rule("ros_service", "/reset", "ros_call")))
    report = verified(ros, 3)
    assert set(wrong(report)) == {("false-negative", "/talker", "ros_call")}
    assert "reset" not in said(report)


def test_a_right_too_many_that_only_a_raw_rule_of_a_document_has(ros: RosSystem) -> None:
    """A service is two topics of the document, which no rule of the policy mentions."""
    ros.provision(PAIR.replace(PUBLISHES, PUBLISHES + rule("ros_service", "/reset", "ros_call")))
    in_force(ros, PAIR)
    assert wrong(verified(ros, 3)) == {("false-positive", "/talker", "ros_call"): 1}


def test_the_wrong_layout(ros: RosSystem) -> None:
    ros.provision(PAIR, "ws", "--layout", "flat")
    report = verified(ros, 3)
    assert {error for error, _, _ in wrong(report)} == {"false-negative"}
    assert {subject for _, subject, _ in wrong(report)} == {"/talker", "/listener"}
    assert "no node starts" in said(report)
    assert "does not exist" in said(report)


def test_the_wrong_domain(ros: RosSystem, install: Path) -> None:
    for file in (ros.folder / "ws/profile/package.defaults").glob("*.xml"):
        file.write_text(file.read_text().replace("<id>0</id>", "<id>5</id>"))
    report = verified(ros, 3)
    assert {error for error, _, _ in wrong(report)} == {"false-negative"}
    assert "no node starts" in said(report)


def test_old_permissions(ros: RosSystem, install: Path) -> None:
    old = (install / "enclaves/talker/permissions.p7s").read_bytes()
    ros.provision(LESS)
    verified(ros, 0)
    (install / "enclaves/talker/permissions.p7s").write_bytes(old)
    found = wrong(verified(ros, 3))
    assert {("false-positive", "/talker", "ros_publish"), ("false-negative", "/talker", "ros_publish")} <= set(found)


def test_old_permissions_of_an_earlier_generation_start_no_node(ros: RosSystem, install: Path) -> None:
    old = (install / "enclaves/talker/permissions.p7s").read_bytes()
    ros.provision(LESS, "ws", "--revoke-superseded")
    (install / "enclaves/talker/permissions.p7s").write_bytes(old)
    report = verified(ros, 3)
    assert {(error, subject) for error, subject, _ in wrong(report)} == {("false-negative", "/talker")}
    assert "no node starts" in said(report)


def test_the_wrong_authority(ros: RosSystem, install: Path) -> None:
    foreign = ros.provision(PAIR, "foreign")
    for name in ("identity_ca.cert.pem", "permissions_ca.cert.pem"):
        shutil.copyfile(foreign / "enclaves/talker" / name, install / "enclaves/talker" / name)
    report = verified(ros, 3)
    assert {(error, subject) for error, subject, _ in wrong(report)} == {("false-negative", "/talker")}
    assert "no node starts" in said(report)


def test_an_enclave_of_another_keystore(ros: RosSystem, install: Path) -> None:
    """It is right in itself, so its node starts; whom it trusts is a finding of its own."""
    foreign = ros.provision(PAIR, "foreign")
    shutil.rmtree(install / "enclaves/talker")
    shutil.copytree(foreign / "enclaves/talker", install / "enclaves/talker")
    report = verified(ros, 3)
    assert not wrong(report)
    assert any(each["subject"] == "/talker" for each in report["diagnostics"])
