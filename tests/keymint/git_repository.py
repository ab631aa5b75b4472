# SPDX-License-Identifier: Apache-2.0
"""A git repository around a workspace."""

from __future__ import annotations

import subprocess
from pathlib import Path


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
