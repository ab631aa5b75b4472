# SPDX-License-Identifier: Apache-2.0
"""A fixture for tests that disturb runs."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from .memory import in_memory


@pytest.fixture
def memory() -> Iterator[Path]:
    """Return a temporary folder, in memory if possible."""
    with in_memory() as folder:
        yield folder
