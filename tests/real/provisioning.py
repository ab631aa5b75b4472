"""Provisions keystores as a user does: with the command."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path


def provision(policy: str, folder: Path, *arguments: str) -> Path:
    """Run ``keymint provision`` on a policy.

    Args:
        policy: a ComArmor policy, XML.
        folder: an empty folder for the policy and the workspace.
        arguments: further arguments of the command.

    Returns:
        The install space, in the layout of sros2.
    """
    source = folder / "policy.xml"
    source.write_text(policy, encoding="utf-8")
    workspace = folder / "ws"
    command = [sys.executable, "-m", "keymint", "provision", str(source), "-w", str(workspace), *arguments]
    searched = os.pathsep.join(str(Path(entry).resolve()) for entry in sys.path if entry)
    done = subprocess.run(
        command, env={**os.environ, "PYTHONPATH": searched}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, f"{command} ended with {done.returncode}:\n{done.stdout}{done.stderr}"
    return workspace / "install"


def enclave(install: Path, subject: str) -> Path:
    """Return the folder of a subject's enclave in an install space."""
    return install / "enclaves" / subject.removeprefix("/")
