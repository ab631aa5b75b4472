# SPDX-License-Identifier: Apache-2.0
"""Certificates and signed documents of the enclaves."""

from __future__ import annotations

from pathlib import Path

from tests.conftest import snapshot


def test_nothing_is_signed_again_for_want_of_a_record(keymint, provisioned: Path) -> None:
    before = snapshot(provisioned / "install")
    (provisioned / ".keymint/state.json").unlink()
    assert keymint("build", cwd=provisioned).code == 0
    assert keymint("install", cwd=provisioned).code == 0
    assert snapshot(provisioned / "install") == before
