# SPDX-License-Identifier: Apache-2.0
"""A verification in parts gives what one in a single process gives."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.conftest import CHECKOUT, NOW

IN_PARTS = "import sys, keymint.verify.verification as v; v.LEAST = 1; from keymint.cli import main; sys.exit(main())"


@pytest.fixture(scope="module")
def changed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A workspace whose policy was changed after the installation, so that there are mismatches."""
    folder = tmp_path_factory.mktemp("parts")
    shutil.copytree(CHECKOUT / "examples/fleet", folder / "fleet")
    assert run(folder, "provision", "fleet", "-w", "ws", "-q").returncode == 0
    for file in (folder / "fleet").rglob("*.xml"):
        text = file.read_text()
        file.write_text(text.replace("<ros_publish/>", "<ros_subscribe/>").replace('"DENY"', '"ALLOW"'))
    return folder


def run(folder: Path, *arguments: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", IN_PARTS, *map(str, arguments)], cwd=folder, capture_output=True, text=True, check=False,
        env={**os.environ, "SOURCE_DATE_EPOCH": str(NOW), "PYTHONPATH": str(CHECKOUT)},
    )  # fmt: skip


@pytest.mark.parametrize("limit", [1, 1000])
def test_any_number_of_processes_gives_the_same_mismatches(changed: Path, limit: int) -> None:
    call = ("verify", "-w", "ws", "-i", "omg", "-i", "fastdds-2.9", "--json", "--limit", limit)
    alone, together = run(changed, *call, "-j", 1), run(changed, *call, "-j", 3)
    assert alone.returncode == 3
    assert (together.returncode, together.stdout, together.stderr) == (3, alone.stdout, alone.stderr)
