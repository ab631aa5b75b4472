# SPDX-License-Identifier: Apache-2.0
"""Run git, and extract files of a revision. No other module runs git."""

from __future__ import annotations

import subprocess
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path

from keymint.errors import KeymintError

_SECONDS = 120
GIT_MISSING = "git-missing"
"""Diagnostic code if git cannot be run."""


def is_revision(text: str, folder: Path) -> bool:
    """Return True for ``REV:path``, unless a file has that name."""
    return ":" in text and not (folder / text).exists()


@contextmanager
def at_revision(text: str, folder: Path, environment: Mapping[str, str]) -> Iterator[tuple[str, Path, Path]]:
    """Extract a path of a revision to a temporary folder that is removed afterwards.

    Args:
        text: ``REV:path``; as in git, the path is relative to the repository, or with ``./`` to the folder.
        folder: a folder of the repository.
        environment: environment variables for git.

    Returns:
        A context with the name of the revision, the path in the extracted tree, and the folder of that tree.

    Raises:
        KeymintError: there is no git, no repository, no such revision, or no such path at it.
    """
    name, _, path = text.partition(":")
    if not name or name.startswith("-"):
        raise KeymintError(f"{text!r} has no revision", help="write REV:path, e.g. HEAD~1:policy", code="revision")
    top = Path(run_git(("rev-parse", "--show-toplevel"), folder, environment).decode().rstrip("\n"))
    if path.startswith(("./", "../")):
        prefix = run_git(("rev-parse", "--show-prefix"), folder, environment).decode().rstrip("\n")
        path = f"{prefix}{path}"
    commit = run_git(
        ("rev-parse", "--verify", "--quiet", "--end-of-options", f"{name}^{{commit}}"), top, environment, name
    )
    with tempfile.TemporaryDirectory(prefix="keymint-") as temporary:
        root = Path(temporary).resolve() / "tree"
        index = {**environment, "GIT_INDEX_FILE": f"{temporary}/index"}  # that of the user stays as it is
        run_git(("read-tree", commit.decode().strip()), top, index)
        run_git(("checkout-index", "--all", f"--prefix={root}/"), top, index)  # git refuses names that lead elsewhere
        extracted = (root / path).resolve()
        if not extracted.is_relative_to(root) or not extracted.exists():
            help_ = "the path is relative to the repository; with ./ to the current folder"
            raise KeymintError(f"there is no {path!r} at {name!r}", help=help_, code="revision")
        yield name, extracted, root


def revision_before(moment: datetime, folder: Path, environment: Mapping[str, str]) -> str:
    """Return the latest commit of the current branch at a time, by the date that its committer gave it.

    Args:
        moment: the time, UTC.
        folder: a folder of the repository.
        environment: environment variables for git.

    Raises:
        KeymintError: there is no git, no repository, or no commit that is as old.
    """
    arguments = ("rev-list", "--max-count=1", f"--before={moment.isoformat()}", "HEAD")
    if commit := run_git(arguments, folder, environment).decode().strip():
        return commit
    message = f"no commit is as old as {moment:%Y-%m-%d %H:%M} UTC"
    raise KeymintError(message, help="name a later time, or a revision", code="revision")


def run_git(arguments: tuple[str, ...], folder: Path, environment: Mapping[str, str], revision: str = "") -> bytes:
    """Run git without a shell and return its standard output.

    Args:
        arguments: arguments of git.
        folder: working directory.
        environment: environment variables.
        revision: name of the requested revision, for messages.

    Raises:
        KeymintError: git is missing (with the code :data:`GIT_MISSING`), or fails.
    """
    try:
        done = subprocess.run(  # noqa: S603 - the program is fixed, and an argument cannot become an option
            ["git", *arguments],  # noqa: S607 - the user's own git
            cwd=folder,
            env=dict(environment),
            stdin=subprocess.DEVNULL,
            capture_output=True,
            check=False,
            timeout=_SECONDS,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise KeymintError(f"git cannot be run: {error}", help="install git", code=GIT_MISSING) from None
    if done.returncode:
        if revision:
            raise KeymintError(
                f"there is no revision {revision!r}", help="'git log --oneline' lists them", code="revision"
            )
        reason = (done.stderr.decode(errors="replace").strip().splitlines() or ["unknown reason"])[0]
        raise KeymintError(f"git failed: {reason}", help="run this in a checkout of git", code="revision")
    return done.stdout
