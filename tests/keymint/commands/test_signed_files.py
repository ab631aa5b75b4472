# SPDX-License-Identifier: Apache-2.0
"""Signed files that other tools wrote: every verb reads them with the one reader, and claims nothing beyond it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from keymint.pki import certificates, keys
from tests.conftest import Outcome, snapshot
from tests.keymint.pki.test_signed_forms import spliced
from tests.signers import HAVE_OPENSSL, SIGNERS, Sign, by_openssl

pytestmark = pytest.mark.skipif(not HAVE_OPENSSL, reason="openssl is not installed: apt-get install openssl")
FOREIGN = ["openssl-smime", "openssl-smime-crlf", "openssl-smime-sha512", "openssl-cms", "sros2"]
ASKED = ("-i", "omg", "-i", "cyclonedds-0.10", "-i", "fastdds-2.9")
REQUEST = ("why", "/talker", "ros_publish", "/chatter", "-i", "omg")


def enclave(workspace: Path) -> Path:
    return workspace / "install/enclaves/talker"


def signed_by(sign: Sign, workspace: Path, content: bytes) -> bytes:
    certificate = certificates.load((workspace / "public/permissions_ca.cert.pem").read_bytes())
    return sign(content, certificate, keys.from_pem((workspace / "private/permissions_ca.key.pem").read_bytes(), None))


def content_of(workspace: Path, kind: str) -> bytes:
    shared = workspace / "install/enclaves/governance.xml"
    return (enclave(workspace) / "permissions.xml" if kind == "permissions" else shared).read_bytes()


@pytest.mark.parametrize("signer", FOREIGN)
def test_what_other_tools_sign_is_read_by_every_verb(
    keymint: Callable[..., Outcome], provisioned: Path, signer: str
) -> None:
    for kind in ("permissions", "governance"):
        signed = signed_by(SIGNERS[signer], provisioned, content_of(provisioned, kind))
        (enclave(provisioned) / f"{kind}.p7s").write_bytes(signed)
    before = snapshot(provisioned / "install")
    proven = keymint("prove", cwd=provisioned)
    assert (proven.code, "18 of 18 claims proven" in proven.out) == (0, True), proven
    verified = keymint("verify", *ASKED, cwd=provisioned)
    assert verified.code == 0, verified
    checked = keymint("check", "--json", cwd=provisioned)
    assert checked.codes() == ["file-changed", "file-changed"], "the record tells, and nothing else is reported"
    explained = keymint(*REQUEST, "--json", cwd=provisioned)
    assert (explained.code, explained.document["result"]["transports"][0]["allowed"]) == (0, True)
    assert keymint("install", cwd=provisioned).code == 0
    assert snapshot(provisioned / "install") == before, "what is signed soundly is not signed again"
    assert keymint("check", cwd=provisioned).code == 0


@pytest.mark.parametrize("signer", ["keymint", "openssl-smime", "sros2"])
@pytest.mark.parametrize("kind", ["permissions", "governance"])
def test_a_file_of_which_vendors_read_an_old_document(
    keymint: Callable[..., Outcome], provisioned: Path, signer: str, kind: str
) -> None:
    """No key is needed for it; openssl, Cyclone DDS and Fast DDS read the old document, which permits more."""
    current = content_of(provisioned, kind)
    old = current.replace(b"rt/chatter<", b"*<").replace(b"control>true", b"control>false")
    assert old != current
    pair = (signed_by(SIGNERS[signer], provisioned, each) for each in (old, current))
    (enclave(provisioned) / f"{kind}.p7s").write_bytes(spliced(*pair))
    place = f"install/enclaves/talker/{kind}.p7s:6: error: is malformed or ambiguous S/MIME"
    proven = keymint("prove", cwd=provisioned)
    assert (proven.code, place in proven.err) == (3, True), proven
    checked = keymint("check", cwd=provisioned)
    assert (checked.code, place in checked.err) == (3, True), checked
    for arguments in (("verify", *ASKED), REQUEST):
        outcome = keymint(*arguments, cwd=provisioned)
        assert (outcome.code, place in outcome.err) == (1, True), outcome
        assert "it is not known what vendors permit" in outcome.err
    installed = keymint("install", cwd=provisioned)
    assert installed.code == 0, installed
    assert keymint("check", cwd=provisioned).code == 0


def test_a_form_that_is_not_read_is_not_said_to_be_denied(keymint: Callable[..., Outcome], provisioned: Path) -> None:
    """Vendors accept an opaque signature, so that "denied" would be a false claim."""
    content = (enclave(provisioned) / "permissions.xml").read_bytes()
    opaque = signed_by(lambda *signed: by_openssl(*signed, "smime", "-nodetach"), provisioned, content)
    (enclave(provisioned) / "permissions.p7s").write_bytes(opaque)
    for arguments in (("verify", *ASKED), REQUEST):
        outcome = keymint(*arguments, cwd=provisioned)
        assert outcome.code == 1
        assert "permissions.p7s:2: error: is malformed or ambiguous S/MIME" in outcome.err
        assert "Traceback" not in outcome.err
    assert keymint("prove", cwd=provisioned).code == 3
