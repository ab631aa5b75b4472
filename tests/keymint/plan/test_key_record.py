# SPDX-License-Identifier: Apache-2.0
"""The record of key pairs."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from keymint.pki import keys
from tests.keymint.plan.keystores import (
    AUTHORITY_KEYS,
    IDENTITY_KEYS,
    another_key,
)


def test_the_key_of_a_pruned_package_is_forgotten(keymint, ws: Path) -> None:
    shutil.rmtree(ws / "src/talker")
    assert keymint("install", "--prune", "--no-prove", cwd=ws).code == 0
    shutil.rmtree(ws / "private/identities/talker")
    for words in (("create", "--all"), ("build",), ("install",), ("check",)):
        assert keymint(*words, cwd=ws).code == 0


@pytest.mark.parametrize("stage", ["new authority", "renewed identity"])
def test_a_run_that_was_killed_between_key_and_certificate_is_carried_on(keymint, ws: Path, stage: str) -> None:
    """It leaves its mark with the fingerprints of the keys that it was about to store."""
    path = AUTHORITY_KEYS[0] if stage == "new authority" else IDENTITY_KEYS[0]
    another_key(ws, ws / path)
    key = keys.from_pem((ws / path).read_bytes())
    assert keymint("install", cwd=ws).code == 1
    (ws / ".keymint/running").write_text(keys.fingerprint(key))
    assert keymint("install", cwd=ws).code == 0
    assert keymint("check", cwd=ws).code == 0
    assert keys.fingerprint(keys.from_pem((ws / path).read_bytes())) == keys.fingerprint(key)
