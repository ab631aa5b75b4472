"""The stage ``build``: what is rebuilt, and edits by hand."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.conftest import snapshot


@pytest.fixture
def ws(keymint, policy: Path, tmp_path: Path) -> Path:
    assert keymint("init", "ws", "--policy", policy).code == 0
    assert keymint("create", "--all", "-w", "ws").code == 0
    return tmp_path / "ws"


def test_again_writes_nothing(keymint, ws: Path) -> None:
    keymint("build", cwd=ws)
    before = snapshot(ws)
    outcome = keymint("build", cwd=ws)
    assert "nothing to do: 2 packages up to date" in outcome.out
    assert snapshot(ws) == before


def test_a_lost_record_is_no_reason_to_write_documents(keymint, ws: Path) -> None:
    keymint("build", cwd=ws)
    before = snapshot(ws / "build"), snapshot(ws / "private")
    (ws / ".keymint/state.json").write_text("{")
    assert keymint("build", cwd=ws).code == 0
    assert (snapshot(ws / "build"), snapshot(ws / "private")) == before


def test_a_defect_in_one_package_stops_all_before_the_first_byte(keymint, ws: Path) -> None:
    path = ws / "src/talker/permissions.xml"
    path.write_text(path.read_text().replace("<attachment>/chatter", "<attachmnt>/chatter"))
    before = snapshot(ws)
    outcome = keymint("build", cwd=ws)
    assert outcome.code == 1
    assert outcome.err.startswith("src/talker/permissions.xml:")
    assert snapshot(ws) == before


def test_only_what_changed_is_built_anew(keymint, ws: Path, policy: Path) -> None:
    keymint("build", cwd=ws)
    before = snapshot(ws / "build/robot1/listener")
    policy.write_text(policy.read_text().replace("<permissions><ros_publish/>", "<permissions><ros_subscribe/>"))
    keymint("create", "--all", cwd=ws)
    outcome = keymint("build", "-v", cwd=ws)
    assert outcome.code == 0
    assert snapshot(ws / "build/robot1/listener") == before
    lines = outcome.out.splitlines()
    assert any(line.split()[:3] == ["updated", "build", "talker"] for line in lines)
    assert any(line.split()[:3] == ["unchanged", "build", "robot1/listener"] for line in lines)


class TestEditsByHand:
    def edit(self, ws: Path) -> Path:
        path = ws / "build/talker/permissions.xml"
        path.write_text(path.read_text().replace("rt/chatter", "rt/edited"))
        return path

    def test_are_kept_and_said(self, keymint, ws: Path) -> None:
        keymint("build", cwd=ws)
        path = self.edit(ws)
        outcome = keymint("build", cwd=ws)
        assert outcome.code == 0
        assert "permissions.xml edited by hand" in outcome.out
        assert "rt/edited" in path.read_text()

    def test_and_changed_sources_are_a_conflict(self, keymint, ws: Path, policy: Path) -> None:
        keymint("build", cwd=ws)
        path = self.edit(ws)
        policy.write_text(policy.read_text().replace("/chatter", "/other"))
        keymint("create", "--all", cwd=ws)
        outcome = keymint("build", cwd=ws)
        assert outcome.code == 1
        assert "build/talker/permissions.xml: error: was edited by hand" in outcome.err
        assert "rt/edited" in path.read_text()

    def test_are_discarded_with_force(self, keymint, ws: Path) -> None:
        keymint("build", cwd=ws)
        path = self.edit(ws)
        assert keymint("build", "-f", "talker", cwd=ws).code == 0
        assert "rt/edited" not in path.read_text()
