# SPDX-License-Identifier: Apache-2.0
"""Gathered permissions on real vendors: they decide as the policy does, and fit into a handshake."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from keymint_ros2_dds.vendors.participants import System, Vendor

from .policies import policy, rule
from .provisioning import enclave

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

COUNT = 2000
"""Number of exact names of each of two subjects: too many for a handshake if written in full."""
ASKED = (
    "rt/cell0/axle0000", "rt/cell3/axle1999", "rt/cell1/axle0717", "rt/cell0/axle2000", "rt/cell0/axle000]",
    "rt/cell0/axle]000", "rt/cell4/axle0000", "rt/cell0/axle00001", "rt/cell/axle0000", "rt/other", "rt/free/x",
)  # fmt: skip


@pytest.fixture(scope="module")
def install(provisioned: Callable[[str | Path], Path]) -> Path:
    names = [f"/cell{number % 4}/axle{number:04}" for number in range(COUNT)]
    talks = rule("ALLOW", "ros_topic", ["ros_publish"], [*names, "/free/*"])
    hears = rule("ALLOW", "ros_topic", ["ros_subscribe"], names)
    profiles = [policy("/talker", [talks]), policy("/listener", [hears])]
    inner = [each.removeprefix("<profiles>").removesuffix("</profiles>") for each in profiles]
    return provisioned(f"<profiles>{''.join(inner)}</profiles>")


def test_the_documents_are_gathered_and_small(install: Path) -> None:
    for subject in ("/talker", "/listener"):
        signed = (enclave(install, subject) / "permissions.p7s").read_bytes()
        assert b"*]*" in signed
        assert len(signed) < 10_000


def test_every_name_is_decided_as_by_the_policy(install: Path, vendor: Vendor) -> None:
    allowed = {*ASKED[:3], "rt/free/x"}
    with System(vendor) as system:
        talker = system.open(enclave(install, "/talker"))
        assert {topic for topic in ASKED if talker.allows("publish", topic)} == allowed
        assert not any(talker.allows("subscribe", topic) for topic in ASKED)


def test_samples_are_exchanged(install: Path, system: System) -> None:
    talker = system.open(enclave(install, "/talker"))
    listener = system.open(enclave(install, "/listener"))
    writer = talker.edge("publish", "rt/cell1/axle0001")
    reader = listener.edge("subscribe", "rt/cell1/axle0001")
    writer.write("hello")
    assert reader.read() == "hello"
