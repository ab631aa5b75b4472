# SPDX-License-Identifier: Apache-2.0
"""An enclave must rest on the authorities of its workspace."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest


@pytest.fixture
def stranger(keymint: Callable, policy: Path, tmp_path: Path) -> Path:
    """The enclaves of another workspace on the same policy, with authorities of its own."""
    assert keymint("provision", policy, "-w", "other").code == 0
    return tmp_path / "other/install/enclaves"


def test_an_enclave_of_another_workspace_is_a_finding_of_every_verb(
    keymint: Callable, provisioned: Path, stranger: Path
):
    keymint("prove", "-w", provisioned)
    enclave = provisioned / "install/enclaves/talker"
    shutil.rmtree(enclave)
    shutil.copytree(stranger / "talker", enclave)
    proved = keymint("prove", "-w", provisioned, "--json")
    assert proved.code == 3
    assert {"authority-differs", "smime-signer", "chain-signature"} & set(proved.codes())
    by_name = {one["subject"]: one for one in proved.document["result"]["enclaves"]}
    assert by_name["/talker"]["proof"] == "unknown"
    assert by_name["/talker"]["claims"] == []
    assert by_name["/robot1/listener"]["proof"] == "proven"
    assert f"'keymint install -w {provisioned}' restores it" in keymint("prove", "-w", provisioned).err
    for arguments in (["verify", "-i", "omg"], ["why", "/talker", "ros_publish", "/chatter", "-i", "omg"]):
        outcome = keymint(*arguments, "-w", provisioned, "--json")
        assert outcome.code == 3, "its own authorities permit it, but they are not ours"
        found = [each for each in outcome.document["diagnostics"] if each["code"] == "authority-differs"]
        assert len(found) == 2
        assert {each["subject"] for each in found} == {"/talker"}
    assert keymint("install", "-w", provisioned).code == 0
    assert keymint("prove", "-w", provisioned).code == 0


def test_a_key_that_was_replaced_is_found_though_the_proof_is_remembered(
    keymint: Callable, provisioned: Path, stranger: Path
):
    assert keymint("prove", "-w", provisioned).code == 0
    (provisioned / "install/enclaves/talker/key.pem").write_bytes((stranger / "talker/key.pem").read_bytes())
    outcome = keymint("prove", "-w", provisioned, "--json")
    assert outcome.code == 3
    assert "key-mismatch" in outcome.codes()


@pytest.mark.parametrize("role", ["identity_ca", "permissions_ca"])
def test_without_the_workspaces_authority_nothing_is_proven(keymint: Callable, provisioned: Path, role: str):
    assert keymint("prove", "-w", provisioned).code == 0
    (provisioned / f"public/{role}.cert.pem").unlink()
    for arguments in (["prove"], ["verify", "-i", "omg"], ["why", "/talker", "ros_publish", "/chatter", "-i", "omg"]):
        outcome = keymint(*arguments, "-w", provisioned)
        assert outcome.code == 3, outcome.out
        assert f"public/{role}.cert.pem: error: the certificate of the authority '{role}' is missing" in outcome.err
        assert "restore it from a backup of the workspace" in outcome.err
