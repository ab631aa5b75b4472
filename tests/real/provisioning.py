# SPDX-License-Identifier: Apache-2.0
"""Provisions keystores with the command, as a user does."""

from __future__ import annotations

import os
import subprocess
import sys
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
    command = [sys.executable, "-m", "keymint", "provision", str(source), "-w", str(workspace), *arguments]
    searched = os.pathsep.join(str(Path(entry).resolve()) for entry in sys.path if entry)
    environment = {**os.environ, "PYTHONPATH": searched}
    environment.pop("SOURCE_DATE_EPOCH", None)  # vendors use the clock of the machine
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{command} ended with {done.returncode}:\n{done.stdout}{done.stderr}"
    return workspace / "install"


def enclave(install: Path, subject: str) -> Path:
    """Return the folder of a subject's enclave in an install space."""
    return install / "enclaves" / subject.removeprefix("/")
