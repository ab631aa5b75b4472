# SPDX-License-Identifier: Apache-2.0
"""``keymint create``."""

from __future__ import annotations

from pathlib import Path

import pytest

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


def test_all_is_every_subject_that_is_named_exactly(keymint, ws: Path) -> None:
    assert keymint("create", "--all", cwd=ws).code == 0
    made = {str(path.relative_to(ws / "src")) for path in (ws / "src").rglob("*.xml")}
    files = ("keymint_package.xml", "permissions.xml", "governance.xml", "identities.xml")
    assert made == {f"robot1/driver/{name}" for name in files}


def test_a_subject_to_whom_a_profile_applies_can_be_named(keymint, ws: Path) -> None:
    assert keymint("create", "/robot2/driver", "robot3/driver", cwd=ws).code == 0
    assert "/robot2/cmd" in (ws / "src/robot2/driver/permissions.xml").read_text()
    assert (ws / "src/robot3/driver/keymint_package.xml").is_file()


def test_a_subject_to_whom_none_applies_is_an_error(keymint, ws: Path) -> None:
    outcome = keymint("create", "/robot1/drivr", "/robot2/driver", cwd=ws)
    assert outcome.code == 1
    assert "no profile of the policy applies to /robot1/drivr (did you mean '/robot1/driver'?)" in outcome.err
    assert not (ws / "src").exists()


@pytest.mark.parametrize(
    "name", ["../x", "/a/../b", "a//b", "a b", "1a", "", "/", "a\nb", "ä", "x" * 300, "a/" * 600 + "a"]
)
def test_names_that_are_not_legal_are_refused(keymint, ws: Path, name: str) -> None:
    outcome = keymint("create", "--", name, cwd=ws)
    assert outcome.code == 1
    assert len(outcome.err.splitlines()) == 1
    assert not (ws / "src").exists()


def test_names_that_differ_by_case_only_are_refused(keymint, tmp_path: Path) -> None:
    (tmp_path / "p.xml").write_text(
        "<profiles><profile name='a'><attachments><attachment>/Robot/a</attachment>"
        "<attachment>/robot/b</attachment></attachments></profile></profiles>"
    )
    outcome = keymint("provision", "p.xml", "-w", "ws2")
    assert outcome.code == 1
    assert "differ only by case" in outcome.err
    assert not (tmp_path / "ws2").exists()


def test_without_a_name_it_is_a_usage_error(keymint, ws: Path) -> None:
    outcome = keymint("create", cwd=ws)
    assert outcome.code == 2
    assert "--all" in outcome.err


def test_the_workspace_is_found_upward(keymint, ws: Path) -> None:
    deep = ws / "profile/comarmor.d"
    assert keymint("create", "--all", cwd=deep).code == 0
    assert (ws / "src/robot1/driver/permissions.xml").is_file()


def test_outside_of_a_workspace(keymint, tmp_path: Path) -> None:
    outcome = keymint("create", "--all", cwd=tmp_path)
    assert outcome.code == 1
    assert "keymint init" in outcome.err
