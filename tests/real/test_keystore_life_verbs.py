# SPDX-License-Identifier: Apache-2.0
"""Keystores that the verbs change, in real participants: who is refused, by whom, and who need not restart.

Every refusal has a control with the same files but for the defence.
"""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from typing import TYPE_CHECKING

import pytest
from keymint_ros2_dds.vendors.participants import RefusedError, System, Vendor

from tests.softhsm import PIN, opened

from .presenters import presenting
from .provisioning import enclave, keymint, provision

if TYPE_CHECKING:
    from pathlib import Path

WAIT = 10.0
POLICY = """<profiles>
  <profile name="talker"><attachment>/talker</attachment>
    <ros_topic qualifier="ALLOW"><attachment>/x</attachment><permissions><ros_publish/></permissions></ros_topic>
    <ros_topic qualifier="ALLOW"><attachment>/wide</attachment><permissions><ros_publish/></permissions></ros_topic>
  </profile>
  <profile name="listener"><attachment>/listener</attachment>
    <ros_topic qualifier="ALLOW"><attachment>/*</attachment><permissions><ros_subscribe/></permissions></ros_topic>
  </profile>
  <profile name="stolen"><attachment>/stolen</attachment>
    <ros_topic qualifier="ALLOW"><attachment>/x</attachment><permissions><ros_publish/></permissions></ros_topic>
  </profile>
</profiles>
"""
WIDE = POLICY.split('<ros_topic qualifier="ALLOW"><attachment>/wide', 1)
NARROW = WIDE[0] + WIDE[1].split("</ros_topic>\n", 1)[1]


@dataclass(frozen=True)
class Stages:
    """The keystore after each step, beside each other."""

    folder: Path
    workspace: Path

    def __call__(self, stage: str, subject: str) -> Path:
        return enclave(self.folder / stage, subject)


@pytest.fixture(scope="module")
def stages(tmp_path_factory: pytest.TempPathFactory) -> Stages:
    """Provision; revoke /stolen; take a right from /talker and supersede it."""
    folder = tmp_path_factory.mktemp("life")
    install = provision(POLICY, folder)
    workspace = install.parent

    def keep(stage: str) -> None:
        shutil.copytree(install, folder / "stages" / stage)

    keep("first")
    keymint("revoke", "stolen", "--reason", "key-compromise", "-w", workspace)
    keep("stolen")
    (folder / "policy.xml").write_text(NARROW)
    provision(folder / "policy.xml", folder)
    keymint("revoke", "talker", "--reason", "superseded", "-w", workspace)
    keep("narrow")
    return Stages(folder / "stages", workspace)


def test_a_revoked_peer_is_refused_and_the_others_go_on(stages: Stages, system: System) -> None:
    informed = system.open(stages("stolen", "/listener")).edge("subscribe", "rt/x")
    trusting = system.open(stages("first", "/listener")).edge("subscribe", "rt/x")
    system.open(stages("first", "/stolen")).edge("publish", "rt/x").write("from the thief")
    assert informed.await_rejection(WAIT)
    assert trusting.read(WAIT) == "from the thief"
    system.open(stages("stolen", "/talker")).edge("publish", "rt/x").write("from the talker")
    assert (informed.read(WAIT), trusting.read(WAIT)) == ("from the talker", "from the talker")


def test_nothing_is_issued_for_a_key_that_was_stolen(stages: Stages) -> None:
    assert stages("first", "/stolen").is_dir()
    assert not stages("stolen", "/stolen").exists()


def test_old_permissions_with_the_old_certificate_are_refused_by_whoever_has_the_new_list(
    stages: Stages, system: System
) -> None:
    informed = system.open(stages("narrow", "/listener")).edge("subscribe", "rt/wide")
    trusting = system.open(stages("stolen", "/listener")).edge("subscribe", "rt/wide")
    system.open(stages("first", "/talker")).edge("publish", "rt/wide").write("as long as I may")
    assert informed.await_rejection(WAIT)
    assert trusting.read(WAIT) == "as long as I may"


@pytest.mark.parametrize("document", ["first", "narrow"])
def test_old_permissions_with_the_new_certificate_are_refused_by_everybody(
    stages: Stages, vendor: Vendor, probe_cache: Path, document: str
) -> None:
    """Also by a peer without any list. The control presents the new permissions in the same way."""
    presented = stages(document, "/talker") / "permissions.p7s"
    with System(presenting(vendor, probe_cache, presented)) as system:
        listener = system.open(stages("first", "/listener")).edge("subscribe", "rt/x")
        system.open(stages("narrow", "/talker"), conforming=False).edge("publish", "rt/x").write("hello")
        if document == "first":
            assert listener.await_rejection(WAIT)
        else:
            assert listener.read(WAIT) == "hello"


def test_a_mixture_of_generations_is_no_participant(stages: Stages, system: System, tmp_path: Path) -> None:
    mixed = shutil.copytree(stages("narrow", "/talker"), tmp_path / "mixed")
    shutil.copy(stages("first", "/talker") / "permissions.p7s", mixed)
    with pytest.raises(RefusedError):
        system.open(mixed)


@pytest.fixture(scope="module")
def in_token(stages: Stages, tmp_path_factory: pytest.TempPathFactory) -> Stages:
    """Move the keys of both authorities into a token, and supersede /talker once more."""
    folder = tmp_path_factory.mktemp("token")
    softhsm = opened(folder / "softhsm")
    workspace = shutil.copytree(stages.workspace, folder / "ws")
    shutil.copy(stages.workspace.parent / "policy.xml", folder)
    profile = workspace / "profile/authorities.xml"
    text = profile.read_text()
    for number, name in enumerate(("identity_ca", "permissions_ca"), start=1):
        file = workspace / f"private/{name}.key.pem"
        uri = softhsm.import_key(file, name, f"{number:02}")
        file.unlink()
        text = text.replace(
            f'<authority name="{name}">', f'<authority name="{name}">\n<key><pkcs11>{uri}</pkcs11></key>'
        )
    profile.write_text(text)
    environment = {**softhsm.environment, "KEYMINT_PKCS11_PIN": PIN}
    keymint("revoke", "talker", "--reason", "superseded", "-w", workspace, environment=environment)
    shutil.copytree(workspace / "install", folder / "stages/token")
    return Stages(folder / "stages", workspace)


@pytest.mark.softhsm
def test_what_a_token_signs(stages: Stages, in_token: Stages, system: System) -> None:
    """Certificate, permissions and revocation list; the listener's other files are from before."""
    listener = in_token("token", "/listener")
    unchanged = {"cert.pem", "key.pem", "permissions.p7s", "identity_ca.cert.pem", "permissions_ca.cert.pem"}
    assert all(
        (listener / name).read_bytes() == (stages("narrow", "/listener") / name).read_bytes() for name in unchanged
    )
    reader = system.open(listener).edge("subscribe", "rt/x")
    system.open(stages("narrow", "/talker")).edge("publish", "rt/x").write("superseded")
    assert reader.await_rejection(WAIT)
    system.open(in_token("token", "/talker")).edge("publish", "rt/x").write("hello")
    assert reader.read(WAIT) == "hello"
