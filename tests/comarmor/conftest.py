# SPDX-License-Identifier: Apache-2.0
"""Policies written into a temporary folder."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import pytest

import comarmor

Write = Callable[[Mapping[str, str | bytes]], Path]


@pytest.fixture
def write(tmp_path: Path) -> Write:
    """Write files below ``tmp_path/policy``, and return that folder."""

    def _write(files: Mapping[str, str | bytes]) -> Path:
        root = tmp_path / "policy"
        for name, content in files.items():
            path = root / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content.encode() if isinstance(content, str) else content)
        return root

    return _write


@pytest.fixture
def load(write: Write) -> Callable[..., comarmor.Policy]:
    """Load a policy from files given as keyword ``name="content"`` or, for the only file, as text."""

    def _load(text: str = "", **files: str) -> comarmor.Policy:
        named = {f"{name.replace('__', '/')}.xml": content for name, content in files.items()}
        return comarmor.load(write({**({"policy.xml": text} if text else {}), **named}))

    return _load


@pytest.fixture
def refused(write: Write) -> Callable[..., comarmor.Diagnostic]:
    """Load a policy that has exactly one defect, and return it; file names are relative to the policy's folder."""

    def _refused(text: str | bytes = "", **files: str) -> comarmor.Diagnostic:
        named: dict[str, str | bytes] = {f"{name.replace('__', '/')}.xml": c for name, c in files.items()}
        root = write({**({"policy.xml": text} if text else {}), **named})
        with pytest.raises(comarmor.ComArmorError) as caught:
            comarmor.load(root)
        (found,) = caught.value.diagnostics
        assert found.where is not None
        assert found.where.file.startswith(str(root))
        return found

    return _refused
