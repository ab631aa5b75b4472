# SPDX-License-Identifier: Apache-2.0
"""Workspaces before the stages ``build`` and ``install``."""

from __future__ import annotations

from pathlib import Path

import pytest


@pytest.fixture
def created(keymint, policy: Path, tmp_path: Path) -> Path:
    """A workspace with source packages that are not built yet."""
    assert keymint("init", "ws", "--policy", policy).code == 0
    assert keymint("create", "--all", "-w", "ws").code == 0
    return tmp_path / "ws"
