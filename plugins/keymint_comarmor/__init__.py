# SPDX-License-Identifier: Apache-2.0
"""What policy types share whose policies are those of the ComArmor language: no plugin by itself."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from pathlib import Path

from keymint.api import PolicySource
from keymint.errors import KeymintError


def file_fingerprint(path: Path) -> bytes:
    """Return a digest of a file that changes when a policy loaded from it may change; empty if it is unreadable."""
    try:
        return hashlib.sha256(path.read_bytes()).digest()
    except OSError:
        return b""


def require_policies(sources: Iterable[PolicySource], what: str) -> None:
    """Check that policies are there.

    Args:
        sources: the policies.
        what: what they may be, as part of a sentence.

    Raises:
        KeymintError: one is not, at the place that names it.
    """
    for source in sources:
        if not source.path.exists():
            message, help_ = f"the policy '{source.path}' does not exist", f"name {what}"
            raise KeymintError(message, where=source.origin, help=help_, code="policy-missing")
