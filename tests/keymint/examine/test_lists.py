# SPDX-License-Identifier: Apache-2.0
"""``keymint check``: revocation lists that are missing, old, or not what the register says."""

from __future__ import annotations

from pathlib import Path

import pytest

from .fault_keystores import LISTENER as LIVING_ENCLAVE
from .presented import codes, findings, keystore

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
    assert (outcome.code, "[register-lost]" in outcome.err) == (1, True)
    assert "and 1 certificate had been revoked" in outcome.err
    assert (provisioned / LISTENER).read_bytes() == before


LIVING = "revokes the certificate of /robot1/listener, which the register does not have as revoked"


@pytest.mark.parametrize("verb", ["check", "prove"])
@pytest.mark.parametrize("file", ["install/enclaves/talker/crl.pem", PUBLIC])
def test_a_list_that_revokes_a_living_enclave(provisioned: Path, keymint, verb: str, file: str) -> None:
    """Signed with the authority's key: with it, both vendors deliver nothing from or to the enclave."""
    store = keystore(provisioned)
    (provisioned / file).write_bytes(store.revocation_list([store.certificate(LIVING_ENCLAVE).serial_number]))
    found = {each["file"]: each for each in findings(keymint, provisioned, verb)}
    assert (found[file]["code"], found[file]["message"]) == ("revocation-list-living", LIVING)


@pytest.mark.parametrize("verb", ["check", "prove"])
def test_a_list_that_revokes_nobody_is_none_of_it(provisioned: Path, keymint, verb: str) -> None:
    (provisioned / PUBLIC).write_bytes(keystore(provisioned).revocation_list([4711]))
    assert "revocation-list-living" not in codes(keymint, provisioned, verb)


@pytest.mark.parametrize("verb", ["check", "prove"])
def test_who_would_accept_the_thief(revoked: Path, keymint, verb: str) -> None:
    (revoked / LISTENER).unlink()
    (found,) = (each for each in findings(keymint, revoked, verb) if each["code"] == "revocation-list-outdated")
    assert found["message"] == "the revocation list is missing: /robot1/listener accepts the revoked /talker"
