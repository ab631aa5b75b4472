# SPDX-License-Identifier: Apache-2.0
"""The record of key pairs."""

from __future__ import annotations

import shutil
from pathlib import Path


def test_the_key_of_a_pruned_package_is_forgotten(keymint, ws: Path) -> None:
    shutil.rmtree(ws / "src/talker")
    assert keymint("install", "--prune", "--no-prove", cwd=ws).code == 0
    shutil.rmtree(ws / "private/identities/talker")
    for words in (("create", "--all"), ("build",), ("install",), ("check",)):
        assert keymint(*words, cwd=ws).code == 0
