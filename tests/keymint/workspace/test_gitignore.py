# SPDX-License-Identifier: Apache-2.0
"""The ``.gitignore`` files keep git out of spaces with secrets or generated files."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from keymint.store.changes import Action, File, FolderChange, Plan, Step
from keymint.view.stamps import State
from keymint.workspace.workspace import Workspace, missing_gitignores
from tests.conftest import snapshot
from tests.keymint.git_repository import committed, secrets

SPACES = [
    (),
    ("--private-space", "vault"),
    ("--install-space", "../ks", "--build-space", "out", "--private-space", "../../secrets"),
    ("--layout", "flat", "--install-space", "keystore"),
]


@pytest.mark.skipif(shutil.which("git") is None, reason="no git")
@pytest.mark.parametrize("own", [None, "*.pyc\n", "!*\n"], ids=["no gitignore", "a gitignore", "a greedy one"])
@pytest.mark.parametrize("spaces", SPACES, ids=" ".join)
def test_add_everything_takes_no_key(keymint, policy: Path, tmp_path: Path, spaces, own: str | None) -> None:
    ws = tmp_path / "repository" / "ws"
    ws.mkdir(parents=True)
    if own:
        (ws / ".gitignore").write_text(own)
        (ws.parent / ".gitignore").write_text(own)
    assert keymint("provision", policy, "-w", ".", *spaces, "--no-prove", cwd=ws).code == 0
    keys = secrets(tmp_path)
    assert len(keys) >= 5
    taken = committed(tmp_path)
    assert not taken & keys
    assert "repository/ws/profile/keymint_profile.xml" in taken
    named = spaces[2:] if "--layout" in spaces else spaces
    outcome = keymint("check", "--json", *named, cwd=ws)
    assert {"key-tracked", "key-exposed"}.isdisjoint(outcome.codes())
    assert outcome.code == 0, outcome.out


def test_none_lies_in_an_enclave(ws: Path) -> None:
    found = {str(path.relative_to(ws)) for path in ws.rglob(".gitignore")}
    assert found == {
        ".gitignore",
        ".keymint/.gitignore",
        "private/.gitignore",
        "build/.gitignore",
        "install/.gitignore",
    }


def test_an_older_workspace_gets_them_with_the_next_run(keymint, ws: Path) -> None:
    for path in ws.rglob(".gitignore"):
        path.unlink()
    (ws / "build/.gitignore").write_text("mine\n")
    assert keymint("install", "--dry-run", cwd=ws).code == 0
    assert not (ws / "private/.gitignore").exists()
    assert keymint("install", cwd=ws).code == 0
    for space in ("private", "install", ".keymint"):
        assert (ws / space / ".gitignore").read_text().splitlines()[-1] == "*"
    assert (ws / "build/.gitignore").read_text() == "mine\n"
    before = snapshot(ws)
    assert keymint("install", cwd=ws).code == 0
    assert snapshot(ws) == before
    assert keymint("check", cwd=ws).code == 0


def test_a_space_that_is_a_link_gets_one_only_with_a_file(ws: Path, tmp_path: Path) -> None:
    (ws / "install").rename(tmp_path / "elsewhere")
    (ws / "install").symlink_to(tmp_path / "elsewhere")
    (tmp_path / "elsewhere/.gitignore").unlink()
    folder = ws / "install/enclaves/talker"
    for change, missing in (
        (FolderChange(folder, removed=("old.pem",)), []),
        (FolderChange(folder, {"new.pem": File(b"new")}), [ws / "install"]),
    ):
        plan = Plan((Step("install", "talker", Action.UPDATED, (change,)),), State())
        assert [each.folder for each in missing_gitignores(Workspace.at(ws, {}, ws), plan)] == missing
