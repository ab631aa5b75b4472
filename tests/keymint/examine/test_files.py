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


def test_an_edited_script_is_a_finding_and_a_missing_one_is_none(keymint: Callable, ws: Path) -> None:
    (ws / "install/keystore.fish").unlink()
    assert keymint("check", "-w", "ws").code == 0
    path = ws / "install/keystore.bash"
    path.write_text(path.read_text() + "export ROS_SECURITY_STRATEGY=Permissive\n")
    (finding,) = keymint("check", "-w", "ws", "--json").document["diagnostics"]
    assert (finding["code"], finding["severity"], finding["file"]) == (
        "file-changed",
        "error",
        "ws/install/keystore.bash",
    )
    assert finding["help"] == "'keymint install -w ws' restores it"
    path.write_text("source /elsewhere\n")
    (finding,) = keymint("check", "-w", "ws", "--json").document["diagnostics"]
    assert finding["help"] == "rename it or remove it, and run 'keymint install -w ws'"


@pytest.mark.parametrize("file", ["governance.p7s", "identity_ca.cert.pem"])
def test_an_altered_file_of_one_enclave_does_not_make_the_common_copy_unexpected(
    keymint: Callable, provisioned: Path, file: str
) -> None:
    path = provisioned / "install/enclaves/talker" / file
    path.write_text(path.read_text().replace("a", "b"))
    outcome = keymint("check", "--json", cwd=provisioned)
    assert {each["file"] for each in outcome.document["diagnostics"]} == {f"install/enclaves/talker/{file}"}


def test_the_mode_and_the_kind_of_a_script_are_checked(keymint: Callable, ws: Path) -> None:
    (ws / "install/keystore.bash").chmod(0o666)
    (ws / "install/keystore.zsh").unlink()
    (ws / "install/keystore.zsh").symlink_to("/dev/null")
    assert {"file-mode", "file-link"} <= set(keymint("check", "-w", "ws", "--json").codes())
