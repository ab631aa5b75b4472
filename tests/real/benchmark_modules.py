# SPDX-License-Identifier: Apache-2.0
"""Loads modules of benchmarks/, whose comparisons tests run on samples."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from types import ModuleType

import pytest


def benchmark(name: str) -> ModuleType:
    """Return a module of benchmarks/, or skip the test if there is no such folder beside the tests."""
    folder = Path(__file__).resolve().parents[2] / "benchmarks"
    if not folder.is_dir():
        pytest.skip("no benchmarks beside these tests")
    sys.path.insert(0, str(folder))
    try:
        return importlib.import_module(name)
    finally:
        sys.path.remove(str(folder))
