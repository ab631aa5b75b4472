# SPDX-License-Identifier: Apache-2.0
"""What implementations accept while an authority changes: claims of ``IMPLEMENTATIONS`` of both build types.

That Fast DDS trusts two authorities of identities at once is in ``test_keystore_life_verbs``.

Every acceptance has a control in which the authorities are two phases apart.
"""

from __future__ import annotations

import shutil
import time
from pathlib import Path

import pytest
from keymint_ros2_dds.vendors.participants import RefusedError, System, Vendor
from keymint_ros2_zenoh.vendors.zenoh_processes import ZenohError

from .compiled_space import CompiledSpace, compiled, policy
from .provisioning import enclave, keymint, provision
from .zenoh_network import real_network

WAIT, PATIENCE = 10.0, 3.0
"""How long something takes at most that happens, and that must not happen, in seconds."""
POLICY = """<profiles>
  <profile name="talker"><attachment>/talker</attachment>
    <ros_topic qualifier="ALLOW"><attachment>/x</attachment><permissions><ros_publish/></permissions></ros_topic>
  </profile>
  <profile name="listener"><attachment>/listener</attachment>
    <ros_topic qualifier="ALLOW"><attachment>/x</attachment><permissions><ros_subscribe/></permissions></ros_topic>
  </profile>
</profiles>
"""
BESIDE = [("before", "distribute"), ("distribute", "reissue"), ("reissue", "end")]
APART = [("before", "reissue")]


def later() -> dict[str, str]:
    """Return the environment of a month from now, when a renewed certificate ends later."""
    return {"SOURCE_DATE_EPOCH": str(int(time.time()) + 30 * 86400)}


def hears(vendor: Vendor, listener: Path, talker: Path, wait: float) -> bool:
    """Tell whether a sample arrives; else one end refuses the other, or its own files."""
    with System(vendor) as system:
        try:
            reader = system.open(listener).edge("subscribe", "rt/x")
            system.open(talker).edge("publish", "rt/x").write("hello")
        except RefusedError:
            return False
        return reader.read(wait) == "hello"


def replaced(workspace: Path, name: str, stages: Path) -> None:
    """Replace the key of an authority by bundles, and keep the keystore of each phase."""
    shutil.copytree(workspace / "install", stages / "before")
    for phase in ("distribute", "reissue", "end"):
        keymint("authority", "replace", name, "--phase", phase, "-w", workspace)
        shutil.copytree(workspace / "install", stages / phase)


# -- DDS -------------------------------------------------------------------------------------------------------------


def test_documents_of_a_reissued_authority_and_those_before_do_not_mix(vendor: Vendor, tmp_path: Path) -> None:
    """That is different for the authority of identities: see ``test_keystore_life``."""
    workspace = provision(POLICY, tmp_path).parent
    shutil.copytree(workspace / "install", tmp_path / "before")
    keymint("authority", "renew", "permissions_ca", "--flag-day", "-w", workspace, environment=later())
    old, new = tmp_path / "before", workspace / "install"
    assert hears(vendor, enclave(new, "/listener"), enclave(new, "/talker"), WAIT)
    assert not hears(vendor, enclave(old, "/listener"), enclave(new, "/talker"), PATIENCE)
    assert not hears(vendor, enclave(new, "/listener"), enclave(old, "/talker"), PATIENCE)


# -- Zenoh -----------------------------------------------------------------------------------------------------------


def connects(workspace: Path, space: Path, others: Path, folder: Path) -> bool:
    """Tell whether a talker of another keystore reaches a listener of the router's own."""
    copied = folder / "ws"
    shutil.copytree(workspace, copied, ignore=shutil.ignore_patterns("install", "stages"))
    shutil.copytree(space, copied / "install")
    shutil.copytree(others / "enclaves/talker", copied / "install/enclaves/other_talker")
    try:
        with real_network(CompiledSpace(copied, folder / "install")) as network:
            network.router()
            listener = network.session("listener")
            return network.reaches(network.session("other_talker"), listener, "0/x/type/hash")
    except ZenohError:
        return False
    finally:
        shutil.rmtree(folder)


@pytest.fixture
def zenoh_workspace(zenoh_library: str, tmp_path: Path) -> Path:
    assert zenoh_library
    return compiled(policy(talker=[("publish", "x")], listener=[("subscribe", "x")]), tmp_path)


@pytest.mark.zenoh
def test_zenoh_trusts_two_authorities_at_once(zenoh_workspace: Path, tmp_path: Path) -> None:
    stages = zenoh_workspace / "stages"
    replaced(zenoh_workspace, "identity_ca", stages)
    for pairs, expected in ((BESIDE, True), (APART, False)):
        for one, two in pairs:
            for router, talker in ((one, two), (two, one)):
                heard = connects(zenoh_workspace, stages / router, stages / talker, tmp_path / "network")
                assert heard == expected, (router, talker)


@pytest.mark.zenoh
def test_zenoh_takes_both_certificates_of_one_key(zenoh_workspace: Path, tmp_path: Path) -> None:
    stages = zenoh_workspace / "stages"
    shutil.copytree(zenoh_workspace / "install", stages / "before")
    keymint("authority", "renew", "identity_ca", "-w", zenoh_workspace, environment=later())
    shutil.copytree(zenoh_workspace / "install", stages / "after")
    for router, talker in (("before", "after"), ("after", "before")):
        assert connects(zenoh_workspace, stages / router, stages / talker, tmp_path / "network"), (router, talker)
