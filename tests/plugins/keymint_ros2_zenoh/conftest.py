# SPDX-License-Identifier: Apache-2.0
"""The real library, as the judge of key expressions."""

from __future__ import annotations

import os
from types import ModuleType

import pytest


@pytest.fixture(scope="session")
def zenoh() -> ModuleType:
    """Return the library; skip without it, or fail with ``KEYMINT_REQUIRE_VENDORS=1``."""
    if os.environ.get("KEYMINT_REQUIRE_VENDORS") == "1":
        import zenoh

        return zenoh
    return pytest.importorskip("zenoh", reason="needs the library: pip install 'keymint[zenoh]'")
