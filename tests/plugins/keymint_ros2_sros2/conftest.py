# SPDX-License-Identifier: Apache-2.0
"""SROS2 policies in a temporary folder."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import pytest

from .sros2_policies import COMMON, ROBOT


@pytest.fixture
def write(tmp_path: Path) -> Callable[..., Path]:
    """Write a policy, and files beside it."""

    def written(text: str, files: Mapping[str, str] | None = None) -> Path:
        for name, content in {"policy.xml": text, **(files or {})}.items():
            (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / name).write_text(content)
        return tmp_path / "policy.xml"

    return written


@pytest.fixture
def robot(write: Callable[..., Path]) -> Path:
    """A policy with the common files."""
    return write(ROBOT, COMMON)
