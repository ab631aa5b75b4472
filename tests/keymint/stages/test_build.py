# SPDX-License-Identifier: Apache-2.0
"""The stage ``build``: what is rebuilt, and edits by hand."""

from __future__ import annotations

from pathlib import Path

from tests.conftest import snapshot


def test_again_writes_nothing(keymint, created: Path) -> None:
    keymint("build", cwd=created)
    before = snapshot(created)
    outcome = keymint("build", cwd=created)
    assert "nothing to do: 2 packages up to date" in outcome.out
    assert snapshot(created) == before


def test_a_lost_record_is_no_reason_to_write_documents(keymint, created: Path) -> None:
    keymint("build", cwd=created)
    before = snapshot(created / "build"), snapshot(created / "private")
    (created / ".keymint/state.json").write_text("{")
    assert keymint("build", cwd=created).code == 0
    assert (snapshot(created / "build"), snapshot(created / "private")) == before


def test_a_defect_in_one_package_stops_all_before_the_first_byte(keymint, created: Path) -> None:
    path = created / "src/talker/permissions.xml"
    path.write_text(path.read_text().replace("<attachment>/chatter", "<attachmnt>/chatter"))
    before = snapshot(created)
    outcome = keymint("build", cwd=created)
    assert outcome.code == 1
    assert outcome.err.startswith("src/talker/permissions.xml:")
    assert snapshot(created) == before


def test_only_what_changed_is_built_again(keymint, created: Path, policy: Path) -> None:
    keymint("build", cwd=created)
    before = snapshot(created / "build/robot1/listener")
    policy.write_text(policy.read_text().replace("<permissions><ros_publish/>", "<permissions><ros_subscribe/>"))
    keymint("create", "--all", cwd=created)
    outcome = keymint("build", "-v", cwd=created)
    assert outcome.code == 0
    assert snapshot(created / "build/robot1/listener") == before
    lines = outcome.out.splitlines()
    assert any(line.split()[:3] == ["updated", "build", "talker"] for line in lines)
    assert any(line.split()[:3] == ["unchanged", "build", "robot1/listener"] for line in lines)


def test_lines_that_move_in_the_policy_change_no_package_and_messages_name_the_present_ones(
    keymint, created: Path, policy: Path
) -> None:
    """A rule more for one subject, or a comment, must not change the sources of all others."""
    policy.write_text(policy.read_text().replace("<attachment>/chatter", "<attachment>/no-name", 1))
    assert keymint("create", "--all", cwd=created).code == 0
    before = snapshot(created / "src")
    stated = keymint("build", cwd=created).err.splitlines()
    policy.write_text(policy.read_text().replace("<profiles", "\n\n<profiles", 1))
    assert keymint("create", "--all", cwd=created).code == 0
    assert snapshot(created / "src") == before
    assert "out of date" not in keymint("build", cwd=created).err
    found = keymint("build", "-f", cwd=created).err.splitlines()
    (line,) = (line for line in stated if "'/no-name'" in line)
    file, number, rest = line.split(":", 2)
    assert f"{file}:{int(number) + 2}:{rest}" in found


class TestEditsByHand:
    def edit(self, created: Path) -> Path:
        path = created / "build/talker/permissions.xml"
        path.write_text(path.read_text().replace("rt/chatter", "rt/edited"))
        return path

    def test_are_kept_and_said(self, keymint, created: Path) -> None:
        keymint("build", cwd=created)
        path = self.edit(created)
        outcome = keymint("build", cwd=created)
        assert outcome.code == 0
        assert "permissions.xml edited by hand" in outcome.out
        assert "rt/edited" in path.read_text()

    def test_and_changed_sources_are_a_conflict(self, keymint, created: Path, policy: Path) -> None:
        keymint("build", cwd=created)
        path = self.edit(created)
        policy.write_text(policy.read_text().replace("/chatter", "/other"))
        keymint("create", "--all", cwd=created)
        outcome = keymint("build", cwd=created)
        assert outcome.code == 1
        assert "build/talker/permissions.xml: error: was edited by hand" in outcome.err
        assert "rt/edited" in path.read_text()

    def test_are_discarded_with_force(self, keymint, created: Path) -> None:
        keymint("build", cwd=created)
        path = self.edit(created)
        assert keymint("build", "-f", "talker", cwd=created).code == 0
        assert "rt/edited" not in path.read_text()
