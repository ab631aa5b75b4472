# SPDX-License-Identifier: Apache-2.0
"""``keymint check``: revocation lists that are missing, old, or not what the register says."""

from __future__ import annotations

from pathlib import Path

import pytest

LISTENER = "install/enclaves/robot1/listener/crl.pem"
PUBLIC = "public/identity_ca.crl.pem"


@pytest.fixture
def revoked(provisioned: Path, keymint) -> Path:
    assert keymint("revoke", "talker", "--reason", "retired", cwd=provisioned).code == 0
    return provisioned


def found(keymint, workspace: Path) -> dict[str, str]:
    diagnostics = keymint("check", "--json", cwd=workspace).document["diagnostics"]
    return {each["file"]: each["code"] for each in diagnostics if each["severity"] == "error"}


@pytest.mark.parametrize("file", [LISTENER, PUBLIC])
def test_a_missing_list(revoked: Path, keymint, file: str) -> None:
    (revoked / file).unlink()
    assert found(keymint, revoked)[file] in {"revocation-list-outdated", "file-missing"}
    assert keymint("install", cwd=revoked).code == 0
    assert found(keymint, revoked) == {}


def test_an_old_list(revoked: Path, keymint) -> None:
    old = (revoked / LISTENER).read_bytes()
    assert keymint("crl", "--refresh", cwd=revoked).code == 0
    (revoked / LISTENER).write_bytes(old)
    assert found(keymint, revoked)[LISTENER] in {"revocation-list-outdated", "file-changed"}
    assert keymint("check", cwd=revoked).code == 3


def test_a_public_list_that_lacks_a_revocation(revoked: Path, keymint) -> None:
    old = (revoked / PUBLIC).read_bytes()
    assert keymint("revoke", "robot1/listener", "--reason", "superseded", cwd=revoked).code == 0
    (revoked / PUBLIC).write_bytes(old)
    assert found(keymint, revoked)[PUBLIC] == "revocation-list-outdated"
    assert keymint("install", cwd=revoked).code == 0
    assert found(keymint, revoked) == {}


def test_a_list_of_the_owner_is_not_overwritten(provisioned: Path, keymint, tmp_path: Path) -> None:
    """Somebody made a list by hand before Keymint had any: its revocations must not end unseen."""
    copy = tmp_path / "copy"
    copy.mkdir()
    assert keymint("revoke", "talker", "--reason", "retired", cwd=provisioned).code == 0
    by_hand = (provisioned / PUBLIC).read_bytes()
    (provisioned / "private/register.sqlite3").unlink()
    for path in provisioned.rglob("*crl.pem"):
        path.unlink()
    (provisioned / "src/talker/issuance.xml").unlink()
    (provisioned / LISTENER).write_bytes(by_hand)
    before = (provisioned / LISTENER).read_bytes()
    outcome = keymint("revoke", "robot1/listener", "--reason", "superseded", cwd=provisioned)
    assert outcome.code == 1
    assert "revokes certificates that the new list does not" in outcome.err
    assert (provisioned / LISTENER).read_bytes() == before
