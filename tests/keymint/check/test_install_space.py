# SPDX-License-Identifier: Apache-2.0
"""``keymint check`` of the install space outside the enclaves."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest


@pytest.mark.parametrize("how", ["all hidden", "all removed"])
def test_nobody_is_told_to_remove_what_enclaves_share(keymint, ws: Path, how: str) -> None:
    if how == "all hidden":
        (ws / "src/KEYMINT_IGNORE").touch()
    else:
        shutil.rmtree(ws / "src")
        (ws / "src").mkdir()
    stray = ws / "install/public/stray.pem"
    stray.write_bytes(b"stray")
    found = keymint("check", "--json", cwd=ws).document["diagnostics"]
    assert [each["file"] for each in found if each["code"] == "file-unexpected"] == ["install/public/stray.pem"]


def test_stray_files_and_empty_folders_are_reported(keymint: Callable, ws: Path) -> None:
    (ws / "install/deep/empty").mkdir(parents=True)
    (ws / "install/public/.git").mkdir()
    (ws / "install/public/.git/config").touch()
    outcome = keymint("check", "--json", cwd=ws)
    assert outcome.code == 3
    places = {(each["code"], each["file"]) for each in outcome.document["diagnostics"]}
    assert places == {("folder-unexpected", "install/deep/empty"), ("file-unexpected", "install/public/.git/config")}
