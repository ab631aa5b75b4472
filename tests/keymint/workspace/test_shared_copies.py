# SPDX-License-Identifier: Apache-2.0
"""The files that all enclaves of the flat layout share."""

from __future__ import annotations

from pathlib import Path


class TestFlatLayout:
    def test_of_ardent(self, keymint, policy: Path, tmp_path: Path) -> None:
        assert keymint("provision", policy, "-w", "ws", "--layout", "flat").code == 0
        folder = tmp_path / "ws/install/talker"
        assert {path.name for path in folder.iterdir()} == {
            "ca.cert.pem",
            "cert.pem",
            "key.pem",
            "governance.p7s",
            "permissions.p7s",
        }
        outcome = keymint("check", "-w", "ws", "--json")
        assert {d["severity"] for d in outcome.document["diagnostics"]} <= {"warning", "note"}


def copy_of(ws: Path) -> Path:
    return ws / "install/public/identity_ca.cert.pem"


def test_install_restores_a_copy_although_no_enclave_changes(keymint, ws: Path) -> None:
    content = copy_of(ws).read_bytes()
    copy_of(ws).write_bytes(b"edited\n")
    assert keymint("check", "-w", "ws").code == 3
    outcome = keymint("install", "-w", "ws")
    assert (outcome.code, "shared by all enclaves" in outcome.out) == (0, True)
    assert copy_of(ws).read_bytes() == content
    assert keymint("check", "-w", "ws").code == 0


def test_an_enclave_that_is_removed_is_no_example_for_the_copies(keymint, ws: Path) -> None:
    assert keymint("authority", "replace", "identity_ca", "--vendor", "fastdds", "-w", "ws").code == 0
    assert keymint("revoke", "robot1/listener", "--reason", "key-compromise", "-w", "ws").code == 0
    assert copy_of(ws).read_bytes() == (ws / "install/enclaves/talker/identity_ca.cert.pem").read_bytes()
    assert keymint("check", "-w", "ws").code == 0
