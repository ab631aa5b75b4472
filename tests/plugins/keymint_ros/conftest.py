# SPDX-License-Identifier: Apache-2.0
"""A new workspace for the tests of this folder."""

from __future__ import annotations

import pytest

from .workspaces import Workspace


@pytest.fixture
def workspace() -> Workspace:
    return Workspace.new()
