# SPDX-License-Identifier: Apache-2.0
"""The stage ``install``: what is written again, repaired, refused."""

from __future__ import annotations

from pathlib import Path

from tests.conftest import snapshot


def test_again_writes_nothing(keymint, just_provisioned: Path) -> None:
    before = snapshot(just_provisioned)
    outcome = keymint("install", cwd=just_provisioned)
    assert "nothing to do" in outcome.out
    assert snapshot(just_provisioned) == before


def test_what_was_not_built(keymint, provisioned: Path, policy: Path) -> None:
    policy.write_text(policy.read_text().replace("<attachment>/talker<", "<attachment>/speaker<"))
    keymint("create", "--all", "--yes", cwd=provisioned)
    outcome = keymint("install", cwd=provisioned)
    assert outcome.code == 1
    assert "the package speaker is not built (run 'keymint build speaker')" in outcome.err


def test_damage_is_repaired(keymint, provisioned: Path) -> None:
    enclave = provisioned / "install/enclaves/talker"
    before = {path.name: path.read_bytes() for path in enclave.iterdir()}
    (enclave / "permissions.p7s").write_bytes(before["permissions.p7s"][:-10])
    (enclave / "key.pem").chmod(0o644)
    assert keymint("install", cwd=provisioned).code == 0
    after = {path.name: path.read_bytes() for path in enclave.iterdir()}
    assert {name for name in before if before[name] != after[name]} == {"permissions.p7s"}
    assert (enclave / "key.pem").stat().st_mode & 0o777 == 0o600
    assert keymint("check", cwd=provisioned).code == 0


def test_a_document_edited_by_hand_is_signed_and_said(keymint, provisioned: Path) -> None:
    path = provisioned / "build/talker/permissions.xml"
    path.write_text(path.read_text().replace("rt/chatter", "rt/edited"))
    outcome = keymint("install", "--no-prove", cwd=provisioned)
    assert outcome.code == 0
    assert "build/talker/permissions.xml: warning: was edited by hand; signing the edited document" in outcome.err
    assert b"rt/edited" in (provisioned / "install/enclaves/talker/permissions.p7s").read_bytes()
    assert keymint("check", cwd=provisioned).code == 3


def test_an_edit_that_keeps_the_meaning_is_signed_and_reported(keymint, provisioned: Path) -> None:
    path = provisioned / "build/talker/permissions.xml"
    path.write_text(path.read_text().replace('<grant name="/talker">', '<grant name="mine">'))
    outcome = keymint("install", cwd=provisioned)
    assert outcome.code == 0
    assert "build/talker/permissions.xml: warning: was edited by hand; signing the edited document" in outcome.err
    assert b'"mine"' in (provisioned / "install/enclaves/talker/permissions.p7s").read_bytes()


def test_an_enclave_that_is_a_link_is_refused(keymint, provisioned: Path, tmp_path: Path) -> None:
    folder = provisioned / "install/enclaves/talker"
    folder.rename(tmp_path / "elsewhere")
    folder.symlink_to(tmp_path / "elsewhere")
    outcome = keymint("install", cwd=provisioned)
    assert outcome.code == 1
    assert "install/enclaves/talker: error: is a symbolic link" in outcome.err
