# SPDX-License-Identifier: Apache-2.0
"""Trees of files at a revision."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

from keymint.errors import KeymintError
from keymint.host.git import at_revision, is_revision


@pytest.fixture
def repository(tmp_path: Path) -> Path:
    """A repository with two revisions of a file."""
    (tmp_path / "d").mkdir()
    file = tmp_path / "d" / "f.xml"
    git(tmp_path, "init", "-q")
    for text in ("old", "new"):
        file.write_text(text)
        git(tmp_path, "add", ".")
        git(tmp_path, "-c", "user.name=n", "-c", "user.email=e@x", "commit", "-q", "-m", text)
    return tmp_path


def git(folder: Path, *arguments: str) -> None:
    subprocess.run(["git", *arguments], cwd=folder, check=True, capture_output=True)


@pytest.mark.parametrize(
    ("text", "inside"), [("HEAD~1:d/f.xml", "."), ("HEAD~1:./f.xml", "d"), ("HEAD~1:d/f.xml", "d")]
)
def test_a_file_as_it_was(repository: Path, text: str, inside: str) -> None:
    with at_revision(text, repository / inside, os.environ) as (_, path, root):
        assert path.read_text() == "old"
    assert not root.exists()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("HEAD~9:d", "no revision 'HEAD~9'"),
        ("HEAD:nope", "there is no 'nope' at 'HEAD'"),
        ("HEAD:../..", "git failed"),
        ("--output=x:d", "has no revision"),
        (":d", "has no revision"),
    ],
)
def test_mistakes(repository: Path, text: str, said: str) -> None:
    with pytest.raises(KeymintError) as caught, at_revision(text, repository, os.environ):
        pass
    assert said in str(caught.value) or "there is no" in str(caught.value)


def test_outside_of_a_repository(tmp_path: Path) -> None:
    environment = {**os.environ, "GIT_CEILING_DIRECTORIES": str(tmp_path.parent)}
    with pytest.raises(KeymintError, match="checkout of git"), at_revision("HEAD:x", tmp_path, environment):
        pass


def test_the_first_line_of_git_has_the_reason(tmp_path: Path) -> None:
    """The lines after it are advice, e.g. at a mount point: which variable would make git search beyond it."""
    program = tmp_path / "git"
    program.write_text(
        "#!/bin/sh\nprintf 'fatal: not a git repository\\nStopping at filesystem boundary\\n' >&2; exit 128\n"
    )
    program.chmod(0o755)
    environment = {**os.environ, "PATH": f"{tmp_path}:{os.environ['PATH']}"}
    with pytest.raises(KeymintError, match="not a git repository"), at_revision("HEAD:x", tmp_path, environment):
        pass


def test_without_git(tmp_path: Path) -> None:
    with pytest.raises(KeymintError, match="install git"), at_revision("HEAD:x", tmp_path, {"PATH": str(tmp_path)}):
        pass


def test_a_file_that_is_named_so_is_a_file(tmp_path: Path) -> None:
    (tmp_path / "a:b").touch()
    assert not is_revision("a:b", tmp_path)
    assert is_revision("HEAD:b", tmp_path)
