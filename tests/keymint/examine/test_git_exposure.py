# SPDX-License-Identifier: Apache-2.0
"""No private key gets into git: not by ``git add -A``, and not without a finding."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat, load_pem_private_key

from tests.conftest import snapshot
from tests.keymint.git_repository import git

GIT = pytest.mark.skipif(shutil.which("git") is None, reason="no git")
pytestmark = GIT


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

    def test_a_request_for_a_certificate_is_no_key(self, keymint, ws: Path) -> None:
        request, key = ws / "private/ca.csr.pem", ws / "private/identity_ca.key.pem"
        subprocess.run(["openssl", "req", "-new", "-key", key, "-subj", "/CN=ca", "-out", request], check=True)
        request.chmod(0o644)
        (ws / "other.csr.pem").hardlink_to(request)
        git(ws.parent, "init", "-q")
        git(ws.parent, "add", "-f", request)
        outcome = keymint("check", cwd=ws)
        assert outcome.code == 0, outcome.out
        request.write_bytes(request.read_bytes() + key.read_bytes())
        found = keymint("check", "--json", cwd=ws)
        assert sorted(found.codes()) == ["file-mode", "key-linked", "key-tracked"]

    def test_a_copy_among_the_sources(self, keymint, ws: Path) -> None:
        git(ws.parent, "init", "-q")
        shutil.copyfile(ws / "private/identity_ca.key.pem", ws / "profile/backup")
        outcome = keymint("check", "--json", cwd=ws)
        assert [(each["code"], each["file"]) for each in outcome.document["diagnostics"]] == [
            ("key-exposed", "profile/backup")
        ]

    def test_a_copy_in_der(self, keymint, ws: Path) -> None:
        git(ws.parent, "init", "-q")
        key = load_pem_private_key((ws / "private/identity_ca.key.pem").read_bytes(), None)
        der = key.private_bytes(Encoding.DER, PrivateFormat.PKCS8, NoEncryption())
        (ws / "profile/backup").write_bytes(der)
        assert keymint("check", "--json", cwd=ws).codes() == ["key-exposed"]

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
