# SPDX-License-Identifier: Apache-2.0
"""Enclaves and authorities that the verbs renew, in real participants: who must restart, and with whom."""

from __future__ import annotations

import shutil
import time
from typing import TYPE_CHECKING

import pytest

from .probe_commands import close
from .provisioning import keymint
from .stages import POLICY, WAIT, Stages, hears

if TYPE_CHECKING:
    from keymint_ros2_dds.vendors.participants import System

pytestmark = pytest.mark.xdist_group("renewed keystores")


@pytest.fixture(scope="module")
def renewed(tmp_path_factory: pytest.TempPathFactory) -> Stages:
    """Provision 250 days ago, for a year; renew /talker now, then the identity authority, then the other one."""
    folder = tmp_path_factory.mktemp("renewed")
    policy, workspace = folder / "policy.xml", folder / "ws"
    policy.write_text(POLICY)
    then = {"SOURCE_DATE_EPOCH": str(int(time.time()) - 250 * 86_400)}
    keymint("provision", policy, "-w", workspace, environment=then)
    shutil.copytree(workspace / "install", folder / "stages/old")
    keymint("renew", "talker", "-w", workspace)
    shutil.copytree(workspace / "install", folder / "stages/new")
    for name, options in (("identity_ca", ()), ("permissions_ca", ("--flag-day",))):
        keymint("authority", "renew", name, *options, "-w", workspace)
        shutil.copytree(workspace / "install", folder / "stages" / name)
    return Stages(folder / "stages", workspace)


def test_a_renewed_enclave_restarts_alone(renewed: Stages, system: System) -> None:
    """The listener runs on; nothing but certificate and permissions of the talker differs."""
    listener = system.open(renewed("old", "/listener")).edge("subscribe", "rt/x")
    before = system.open(renewed("old", "/talker"))
    before.edge("publish", "rt/x").write("before")
    assert listener.read(WAIT) == "before"
    close(before)
    system.open(renewed("new", "/talker")).edge("publish", "rt/x").write("renewed")
    assert listener.read(WAIT) == "renewed"


def test_renewal_changes_certificate_and_permissions_of_its_enclave_alone(renewed: Stages) -> None:
    old, new = (
        {str(path.relative_to(root)): path.read_bytes() for path in root.rglob("*") if path.is_file()}
        for root in (renewed.folder / "old", renewed.folder / "new")
    )
    assert old.keys() == new.keys()
    changed = {"cert.pem", "permissions.p7s", "permissions.xml"}
    assert {name for name in old if old[name] != new[name]} == {f"enclaves/talker/{name}" for name in changed}


@pytest.mark.parametrize(("listener", "talker"), [("new", "identity_ca"), ("identity_ca", "new")])
def test_a_renewed_identity_authority_needs_no_coordination(
    renewed: Stages, system: System, listener: str, talker: str
) -> None:
    assert authority(renewed, "new", "identity_ca") != authority(renewed, "identity_ca", "identity_ca")
    assert hears(system, renewed(listener, "/listener"), renewed(talker, "/talker"))


@pytest.mark.parametrize(("talker", "expected"), [("permissions_ca", True), ("identity_ca", False)])
def test_a_renewed_permissions_authority_is_a_flag_day(
    renewed: Stages, system: System, talker: str, *, expected: bool
) -> None:
    assert authority(renewed, "identity_ca", "permissions_ca") != authority(renewed, "permissions_ca", "permissions_ca")
    assert hears(system, renewed("permissions_ca", "/listener"), renewed(talker, "/talker")) == expected


def authority(stages: Stages, stage: str, name: str) -> bytes:
    return (stages(stage, "/talker") / f"{name}.cert.pem").read_bytes()
