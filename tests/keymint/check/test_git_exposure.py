"""No private key gets into git: not by ``git add -A``, and not without a finding."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from tests.conftest import snapshot

GIT = pytest.mark.skipif(shutil.which("git") is None, reason="no git")
pytestmark = GIT


def git(folder: Path, *words: str) -> str:
    plain = ("-c", "user.name=a", "-c", "user.email=a@b", "-c", "core.excludesFile=/dev/null")
    done = subprocess.run(["git", *plain, *words], cwd=folder, check=True, capture_output=True, text=True)
    return done.stdout


def committed(folder: Path) -> set[str]:
    git(folder, "init", "-q")
    git(folder, "add", "-A")
    return set(git(folder, "ls-files").splitlines())


def secrets(folder: Path) -> set[str]:
    return {
        str(path.relative_to(folder))
        for path in folder.rglob("*")
        if path.is_file() and ".git" not in path.parts and b"PRIVATE KEY" in path.read_bytes()
    }


SPACES = [
    (),
    ("--private-space", "vault"),
    ("--install-space", "../ks", "--build-space", "out", "--private-space", "../../secrets"),
    ("--layout", "flat", "--install-space", "keystore"),
]


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


class TestFindings:
    def exposed(self, ws: Path) -> None:
        for path in ws.rglob(".gitignore"):
            path.unlink()
        git(ws.parent, "init", "-q")

    def test_a_key_that_git_would_take(self, keymint, ws: Path) -> None:
        self.exposed(ws)
        index = snapshot(ws.parent / ".git")
        outcome = keymint("check", "--json", cwd=ws)
        assert outcome.code == 3
        found = [(each["code"], each["file"]) for each in outcome.document["diagnostics"]]
        assert found == [
            ("key-exposed", "private/identities/robot1/listener/key.pem"),
            ("key-exposed", "install/enclaves/robot1/listener/key.pem"),
        ]
        assert "write the line '*' into private/.gitignore" in outcome.out
        assert snapshot(ws.parent / ".git") == index
        for space in ("private", "install"):
            (ws / space / ".gitignore").write_text("*\n")
        assert keymint("check", cwd=ws).code == 0

    def test_a_key_that_git_tracks(self, keymint, ws: Path) -> None:
        self.exposed(ws)
        git(ws, "add", "-A")
        assert keymint("check", "--json", cwd=ws).codes() == ["key-tracked", "key-tracked"]
        for space in ("private", "install"):
            (ws / space / ".gitignore").write_text("*\n")
        assert keymint("check", "--json", cwd=ws).codes() == ["key-tracked", "key-tracked"]
        git(ws, "rm", "-q", "-r", "--cached", "private", "install")
        assert keymint("check", cwd=ws).code == 0

    def test_a_copy_among_the_sources(self, keymint, ws: Path) -> None:
        git(ws.parent, "init", "-q")
        shutil.copyfile(ws / "private/identity_ca.key.pem", ws / "profile/backup")
        outcome = keymint("check", "--json", cwd=ws)
        assert [(each["code"], each["file"]) for each in outcome.document["diagnostics"]] == [
            ("key-exposed", "profile/backup")
        ]

    def test_a_repository_in_the_private_space(self, keymint, ws: Path) -> None:
        (ws / "private/.gitignore").unlink()
        git(ws / "private", "init", "-q")
        assert "key-exposed" in keymint("check", "--json", cwd=ws).codes()

    def test_no_program_of_the_repository_is_run(self, keymint, ws: Path) -> None:
        self.exposed(ws)
        program = ws.parent / "program"
        program.write_text(f"#!/bin/sh\ntouch {ws.parent}/was_run\n")
        program.chmod(0o755)
        git(ws, "config", "core.fsmonitor", str(program))
        git(ws, "config", "core.hooksPath", str(ws.parent))
        outcome = keymint("check", cwd=ws, env={"GIT_DIR": "/nowhere", "GIT_INDEX_FILE": "/nowhere/index"})
        assert "that 'git add' would take" in outcome.err
        assert not (ws.parent / "was_run").exists()

    def test_what_git_refuses_is_unknown(self, keymint, ws: Path) -> None:
        self.exposed(ws)
        (ws.parent / ".git/HEAD").unlink()
        outcome = keymint("check", "--json", cwd=ws)
        assert (outcome.code, outcome.codes()) == (0, ["git-unknown", "git-unknown"])

    def test_without_git_nothing_is_said(self, keymint, ws: Path) -> None:
        self.exposed(ws)
        outcome = keymint("check", "--json", cwd=ws, env={"PATH": "/nowhere"})
        assert (outcome.code, outcome.codes()) == (0, [])
