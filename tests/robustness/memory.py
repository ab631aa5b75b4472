# SPDX-License-Identifier: Apache-2.0
"""Folders in memory, since hundreds of runs synchronise their files."""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path


@contextlib.contextmanager
def in_memory() -> Iterator[Path]:
    """Yield a temporary folder, in memory if the machine has one there."""
    shared = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None
    with tempfile.TemporaryDirectory(dir=shared) as folder:
        yield Path(folder)
