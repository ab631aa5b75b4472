# SPDX-License-Identifier: Apache-2.0
"""``keymint diff``."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

OLD = """<profiles><profile name="a"><attachment>/a</attachment>
<ros_topic qualifier="ALLOW"><attachment>/x</attachment><permissions><ros_publish/></permissions></ros_topic>
</profile></profiles>"""
NEW = OLD.replace("/x<", "/x*<")


@pytest.fixture(autouse=True)
def policies(tmp_path: Path) -> None:
    """Two policies of which the newer one allows more."""
    (tmp_path / "old.xml").write_text(OLD)
    (tmp_path / "new.xml").write_text(NEW)


def test_text(keymint) -> None:
    outcome = keymint("diff", "old.xml", "new.xml")
    assert outcome.code == 3
    assert outcome.out == ("/a:\n  + ros_publish on part of /x*, e.g. /xa (new.xml:2)\n1 subject gains, none lose\n")
    assert keymint("diff", "new.xml", "old.xml").code == 0


def test_only_the_text_changed(keymint, tmp_path: Path) -> None:
    (tmp_path / "same.xml").write_text(OLD.replace("<attachment>/x<", "<attachment>/[x]<"))
    outcome = keymint("diff", "old.xml", "same.xml")
    assert (outcome.code, outcome.out) == (0, "equivalent: no subject gains or loses anything\n")
    assert "**Equivalent**" in keymint("diff", "old.xml", "same.xml", "--format", "markdown").out


def test_markdown(keymint) -> None:
    lines = keymint("diff", "old.xml", "new.xml", "--format", "markdown").out.splitlines()
    assert lines[0] == "### Access control: `old.xml` → `new.xml`"
    assert "| gains | `ros_publish` | on part of `/x*`, e.g. `/xa` | `new.xml:2` |" in lines


@pytest.mark.parametrize("option", [["--json"], ["--format", "json"]])
def test_json(keymint, option: list[str]) -> None:
    document = keymint("diff", "old.xml", "new.xml", *option).document
    assert document["exit_code"] == 3
    (subject,) = document["result"]["subjects"]
    assert subject["changes"] == [
        {
            "change": "gains",
            "kind": "ros_topic",
            "permission": "ros_publish",
            "pattern": "/x*",
            "whole": False,
            "example": "/xa",
            "rule": {"file": "new.xml", "line": 2},
            "unknown": None,
            "build_type": None,
        }
    ]


def test_workspaces(keymint, provisioned: Path, policy: Path) -> None:
    assert keymint("diff", provisioned, policy).out == "equivalent: no subject gains or loses anything\n"


def test_a_revision(keymint, tmp_path: Path) -> None:
    def git(*arguments: str) -> None:
        subprocess.run(["git", *arguments], cwd=tmp_path, check=True, capture_output=True)

    git("init", "-q")
    (tmp_path / "new.xml").write_text("<profiles>")
    git("add", ".")
    git("-c", "user.name=n", "-c", "user.email=e@x", "commit", "-q", "-m", "first")
    (tmp_path / "old.xml").write_text(NEW)
    assert keymint("diff", "old.xml", "HEAD:old.xml").out.splitlines()[1] == (
        "  - ros_publish on part of /x*, e.g. /xa (old.xml:2)"
    )
    defect = keymint("diff", "old.xml", "HEAD:new.xml")
    assert (defect.code, defect.out) == (1, "")
    assert "HEAD:new.xml:1" in defect.err
    assert "no revision 'HEAD~7'" in keymint("diff", "old.xml", "HEAD~7:old.xml").err


def test_a_spent_budget(keymint, tmp_path: Path) -> None:
    for name, attachment in (("s.xml", "/s*"), ("st.xml", "/[st]*")):
        (tmp_path / name).write_text(OLD.replace("/a<", f"{attachment}<"))
    outcome = keymint("diff", "s.xml", "st.xml", "--budget", "1")
    assert outcome.code == 3
    assert "equivalent" not in outcome.out
    assert "raise --budget" in outcome.err
    result = keymint("diff", "s.xml", "st.xml", "--budget", "1", "--json").document["result"]
    assert (result["equivalent"], result["subjects"][0]["subject"]) == (False, None)
    assert "**Equivalent**" not in keymint("diff", "s.xml", "st.xml", "--budget", "1", "--format", "markdown").out
    assert keymint("diff", "s.xml", "st.xml").out.startswith("subjects like /[s-t]* except /s* (e.g. /t) (new):\n")
