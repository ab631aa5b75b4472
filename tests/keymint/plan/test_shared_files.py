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
