# SPDX-License-Identifier: Apache-2.0
"""Loading the policy of a workspace."""

from __future__ import annotations

from pathlib import Path


def test_a_copy_of_a_workspace_follows_its_own_policy(keymint, tmp_path: Path) -> None:
    import shutil

    assert keymint("init", "one").code == 0
    assert keymint("create", "--all", "-w", "one").code == 0
    shutil.copytree(tmp_path / "one", tmp_path / "two")
    policy = tmp_path / "two/profile/comarmor.d/talker_listener.xml"
    policy.write_text(policy.read_text().replace("/chatter", "/other"))
    assert keymint("create", "--all", "-w", "two").code == 0
    assert "/other" in (tmp_path / "two/src/talker/permissions.xml").read_text()
