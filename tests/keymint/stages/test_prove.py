# SPDX-License-Identifier: Apache-2.0
"""The stage ``prove``: which proofs are cached, and which are not."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from keymint.pki import certificates, keys, smime


def resign(workspace: Path, name: str, old: str, new: str) -> None:
    """Replace a text of an installed document, and sign it again."""
    folder = workspace / "install/enclaves" / name
    content = (folder / "permissions.xml").read_text()
    assert old in content
    certificate = certificates.load((workspace / "public/permissions_ca.cert.pem").read_bytes())
    key = keys.from_pem((workspace / "private/permissions_ca.key.pem").read_bytes(), None)
    (folder / "permissions.p7s").write_bytes(smime.sign(content.replace(old, new).encode(), certificate, key))


def test_what_was_proven_is_not_proven_again_until_something_changes(keymint: Callable, provisioned: Path):
    keymint("prove", "-w", provisioned)

    def unchanged() -> list[bool]:
        found = keymint("prove", "-w", provisioned, "--json").document["result"]["enclaves"]
        return [one["unchanged"] for one in found]

    assert unchanged() == [True, True]
    resign(provisioned, "talker", "rt/chatter", "rt/chatte?")
    assert unchanged() == [True, False]
    assert unchanged() == [True, False], "what is refuted is not remembered"
    keymint("install", "-w", provisioned)
    keymint("prove", "-w", provisioned)
    assert unchanged() == [True, True]


def test_the_policy_is_what_counts_and_not_what_was_built(keymint: Callable, provisioned: Path, policy: Path):
    keymint("prove", "-w", provisioned)
    policy.write_text(policy.read_text().replace("/chatter", "/chat*"))
    outcome = keymint("prove", "-w", provisioned)
    assert outcome.code == 3
    assert "'rt/chat'" in outcome.err


def test_an_enclave_that_cannot_be_read(keymint: Callable, provisioned: Path):
    (provisioned / "install/enclaves/talker/permissions.p7s").write_bytes(b"nonsense")
    outcome = keymint("prove", "-w", provisioned)
    assert outcome.code == 3
    assert "could not be read" in outcome.out
    assert "Traceback" not in outcome.err


def test_an_enclave_that_is_not_installed(keymint: Callable, provisioned: Path):
    for path in (provisioned / "install/enclaves/talker").iterdir():
        path.unlink()
    outcome = keymint("prove", "-w", provisioned, "talker", "--json")
    assert outcome.code == 3
    assert "enclave-missing" in outcome.codes()


def test_what_install_proved_is_known_to_prove(keymint: Callable, provisioned: Path):
    assert keymint("install", "-w", provisioned).code == 0
    found = keymint("prove", "-w", provisioned, "--json").document["result"]["enclaves"]
    assert [one["unchanged"] for one in found] == [True, True]
