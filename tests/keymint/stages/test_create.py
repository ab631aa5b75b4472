# SPDX-License-Identifier: Apache-2.0
"""The stage ``create``: packages follow the policy, and edits by hand are kept."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from keymint_ros import permissions

from keymint.ir import SubjectRules

PROFILE = """<profiles>
  <profile name="any">
    <attachment>/robot?/driver</attachment>
    <ros_topic qualifier="ALLOW"><attachment>{namespace}cmd</attachment><permissions><ros_subscribe/></permissions>
    </ros_topic>
  </profile>
  <profile name="one"><attachment>/robot1/driver</attachment></profile>
</profiles>
"""


@pytest.fixture
def ws(keymint, tmp_path: Path) -> Path:
    (tmp_path / "p.xml").write_text(PROFILE)
    assert keymint("init", "ws", "--policy", "p.xml").code == 0
    return tmp_path / "ws"


def test_again_writes_nothing(keymint, ws: Path) -> None:
    keymint("create", "--all", cwd=ws)
    outcome = keymint("create", "--all", cwd=ws)
    assert "nothing to do: 1 package up to date" in outcome.out


def test_a_changed_policy_reaches_existing_packages(keymint, ws: Path, tmp_path: Path) -> None:
    keymint("create", "--all", "robot2/driver", cwd=ws)
    (tmp_path / "p.xml").write_text(PROFILE.replace("{namespace}cmd", "{namespace}command"))
    assert keymint("create", "--all", cwd=ws).code == 0
    for robot in ("robot1", "robot2"):
        assert f"/{robot}/command" in (ws / f"src/{robot}/driver/permissions.xml").read_text()


def test_only_a_subject_whose_rules_changed_is_rendered_again(keymint, ws: Path, tmp_path: Path, monkeypatch) -> None:
    keymint("create", "--all", "robot2/driver", cwd=ws)
    rendered: list[str] = []
    render = permissions.render

    def spy(rules: SubjectRules, *arguments: Any, **options: Any) -> bytes:
        rendered.append(rules.subject)
        return render(rules, *arguments, **options)

    monkeypatch.setattr(permissions, "render", spy)
    own = '<ros_topic qualifier="DENY"><attachment>/x</attachment><permissions><ros_publish/></permissions></ros_topic>'
    named = "/robot1/driver</attachment>"
    (tmp_path / "p.xml").write_text(PROFILE.replace(named, named + own))
    outcome = keymint("create", "--all", cwd=ws)
    assert rendered == ["/robot1/driver"]
    assert "1 updated, 1 unchanged" in outcome.out
    assert "nothing to do: 2 packages up to date" in keymint("create", "--all", cwd=ws).out


def test_permissions_that_are_withdrawn_do_not_live_on(keymint, ws: Path, tmp_path: Path) -> None:
    keymint("create", "--all", "robot2/driver", cwd=ws)
    (tmp_path / "p.xml").write_text(
        "<profiles><profile name='o'><attachment>/robot1/driver</attachment></profile></profiles>"
    )
    outcome = keymint("create", "--all", cwd=ws)
    assert outcome.code == 0
    assert "no profile of the policy applies to /robot2/driver any more" in outcome.err
    assert "/robot2/cmd" not in (ws / "src/robot2/driver/permissions.xml").read_text()


class TestEditsByHand:
    """Three versions: written last, there now, to be written."""

    def edit(self, ws: Path) -> Path:
        path = ws / "src/robot1/driver/permissions.xml"
        path.write_text(path.read_text().replace("/robot1/cmd", "/robot1/cmd_edited"))
        return path

    def test_an_edit_is_kept_while_the_policy_does_not_change(self, keymint, ws: Path) -> None:
        keymint("create", "--all", cwd=ws)
        path = self.edit(ws)
        assert keymint("create", "--all", cwd=ws).code == 0
        assert "cmd_edited" in path.read_text()

    def test_an_edit_and_a_changed_policy_are_a_conflict(self, keymint, ws: Path, tmp_path: Path) -> None:
        keymint("create", "--all", cwd=ws)
        path = self.edit(ws)
        (tmp_path / "p.xml").write_text(PROFILE.replace("{namespace}cmd", "{namespace}other"))
        outcome = keymint("create", "--all", cwd=ws)
        assert outcome.code == 1
        assert "src/robot1/driver/permissions.xml" in outcome.err
        assert "--force" in outcome.err
        assert "cmd_edited" in path.read_text()
        assert keymint("create", "--all", "--force", cwd=ws).code == 0
        assert "/robot1/other" in path.read_text()

    def test_other_files_of_a_package_are_never_touched(self, keymint, ws: Path, tmp_path: Path) -> None:
        keymint("create", "--all", cwd=ws)
        path = ws / "src/robot1/driver/governance.xml"
        path.write_text(path.read_text() + "<!-- mine -->\n")
        (tmp_path / "p.xml").write_text(PROFILE.replace("{namespace}cmd", "{namespace}other"))
        assert keymint("create", "--all", cwd=ws).code == 0
        assert path.read_text().endswith("<!-- mine -->\n")
