# SPDX-License-Identifier: Apache-2.0
"""Decisions of both vendors on handmade documents, in real participants: the facts that portability relies on."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from cryptography.x509.oid import NameOID
from keymint_ros2_dds.vendors.participants import DeniedError, RefusedError, System, Vendor

from .handmade import Authorities, criteria, rule
from .probe_commands import close

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

PUBLISH_X = criteria("publish", ["rt/x"])
SUBSCRIBE_X = criteria("subscribe", ["rt/x"])
EMPTY = rule("allow", "")


@pytest.mark.parametrize(
    ("rules", "allowed"),
    [
        (EMPTY, []),
        (rule("allow", criteria("relay", ["rt/x"])), []),
        (rule("deny", criteria("relay", ["rt/x"])) + rule("allow", PUBLISH_X), [("publish", "rt/x")]),
        (
            EMPTY + rule("deny", PUBLISH_X) + rule("allow", criteria("publish", ["rt/*"])) + EMPTY,
            [("publish", "rt/y")],
        ),
        (
            rule("allow", PUBLISH_X) + rule("deny", SUBSCRIBE_X) + rule("allow", criteria("subscribe", ["rt/*"])),
            [("publish", "rt/x"), ("subscribe", "rt/y")],
        ),
    ],
    ids=["rule without criteria", "relay only", "relay denied", "punctured wildcard", "one direction denied"],
)
def test_rules(
    authorities: Authorities, system: System, tmp_path: Path, rules: str, allowed: list[tuple[str, str]]
) -> None:
    participant = system.open(authorities.enclave(tmp_path, rules))
    directions: tuple[str, str] = ("publish", "subscribe")
    questions = [(direction, topic) for direction in directions for topic in ("rt/x", "rt/y")]
    assert [question for question in questions if participant.allows(*question)] == allowed


@pytest.mark.parametrize("rules", ["", rule("deny", PUBLISH_X)], ids=["no rule", "deny only"])
def test_without_an_allow_rule_there_is_no_participant(
    authorities: Authorities, system: System, tmp_path: Path, rules: str
) -> None:
    with pytest.raises(RefusedError):
        system.open(authorities.enclave(tmp_path, rules))


@pytest.mark.parametrize(
    ("listed", "answers"),
    [(("",), (True, False, False)), (("a",), (False, True, False)), (("*",), (True, True, True))],
)
def test_partitions(
    authorities: Authorities,
    system: System,
    tmp_path: Path,
    listed: Sequence[str],
    answers: tuple[bool, ...],
) -> None:
    rules = rule("allow", criteria("publish", ["rt/x"], listed))
    participant = system.open(authorities.enclave(tmp_path, rules))
    partitions: tuple[Sequence[str], ...] = ((), ("a",), ("a", "*"))
    assert tuple(participant.allows("publish", "rt/x", each) for each in partitions) == answers


def test_two_rdns_in_the_order_of_rfc_4514(authorities: Authorities, system: System, tmp_path: Path) -> None:
    def enclave(name: str, unit: str, rules: str) -> Path:
        rdns = [(NameOID.ORGANIZATIONAL_UNIT_NAME, unit), (NameOID.COMMON_NAME, name)]
        return authorities.enclave(tmp_path / unit, rules, subject=f"CN={name},OU={unit}", rdns=rdns)

    reader = system.open(enclave("/listener", "b", rule("allow", SUBSCRIBE_X))).edge("subscribe", "rt/x")
    writer = system.open(enclave("/talker", "a", rule("allow", PUBLISH_X))).edge("publish", "rt/x")
    writer.write("hello")
    assert reader.read() == "hello"


@pytest.mark.fastdds
def test_fast_dds_compares_names_as_text_in_the_order_of_rfc_4514(
    authorities: Authorities, fastdds: Vendor, tmp_path: Path
) -> None:
    rdns = [(NameOID.COMMON_NAME, "/robot"), (NameOID.ORGANIZATIONAL_UNIT_NAME, "h")]
    folder = authorities.enclave(tmp_path, rule("allow", PUBLISH_X), subject="CN=/robot,OU=h", rdns=rdns)
    with System(fastdds) as system, pytest.raises(RefusedError):
        system.open(folder)


def test_a_deny_rule_does_not_affect_allowed_topics(authorities: Authorities, system: System, tmp_path: Path) -> None:
    participant = system.open(authorities.enclave(tmp_path, rule("allow", PUBLISH_X)))
    with pytest.raises(DeniedError):
        participant.edge("publish", "rt/y")
    participant.edge("publish", "rt/x")
    close(participant)
