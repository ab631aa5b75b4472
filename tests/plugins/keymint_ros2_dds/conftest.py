# SPDX-License-Identifier: Apache-2.0
"""No test depends on the subjects that others built before."""

from __future__ import annotations

import pytest
from keymint_ros2_dds.emit import kind_members


@pytest.fixture(autouse=True)
def no_known_kinds(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kind_members, "_known", {})
