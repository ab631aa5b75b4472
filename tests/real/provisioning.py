# SPDX-License-Identifier: Apache-2.0
"""Provisions keystores with the command, as a user does."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path


def provision(policy: str | Path, folder: Path, *arguments: str) -> Path:
    """Run ``keymint provision`` on a policy.

    Args:
        policy: a ComArmor policy, as XML or where it lies.
        folder: an empty folder for the policy and the workspace.
        arguments: further arguments of the command.

    Returns:
        The install space, in the layout of sros2.
    """
    source = policy if isinstance(policy, Path) else folder / "policy.xml"
    if isinstance(policy, str):
        source.write_text(policy, encoding="utf-8")
    workspace = folder / "ws"
    keymint("provision", source, "-w", workspace, *arguments)
    return workspace / "install"


def keymint(*arguments: object, code: int = 0, environment: Mapping[str, str] | None = None) -> str:
    """Run the command with the clock of the machine, which vendors use, unless a variable sets it; return its output.

    Args:
        arguments: its arguments.
        code: the exit code that it must have.
        environment: further environment variables.
    """
    command = [sys.executable, "-m", "keymint", *map(str, arguments)]
    searched = os.pathsep.join(str(Path(entry).resolve()) for entry in sys.path if entry)
    variables = {**os.environ, "PYTHONPATH": searched}
    variables.pop("SOURCE_DATE_EPOCH", None)
    variables.update(environment or {})
    done = subprocess.run(command, env=variables, capture_output=True, text=True, check=False)
    assert done.returncode == code, f"{command} ended with {done.returncode}:\n{done.stdout}{done.stderr}"
    return done.stdout


def enclave(install: Path, subject: str) -> Path:
    """Return the folder of a subject's enclave in an install space."""
    return install / "enclaves" / subject.removeprefix("/")
