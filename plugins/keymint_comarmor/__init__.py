# SPDX-License-Identifier: Apache-2.0
"""What policy types share whose policies are those of the ComArmor language: no plugin by itself."""

from __future__ import annotations

import hashlib
from pathlib import Path


def file_fingerprint(path: Path) -> bytes:
    """Return a digest of a file that changes when a policy loaded from it may change; empty if it is unreadable."""
    try:
        return hashlib.sha256(path.read_bytes()).digest()
    except OSError:
        return b""
