# SPDX-License-Identifier: Apache-2.0
"""The scripts of a keystore: who writes them, and what happens to those of others."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from keymint.stages.environment_scripts import SHELLS
from tests.conftest import snapshot

NAMES = tuple(f"keystore.{shell}" for shell in SHELLS)


def scripts(ws: Path, space: str = "install") -> dict[str, str]:
    return {path.name: path.read_text() for path in (ws / space).glob("keystore.*")}


def test_a_new_keystore_has_them(ws: Path) -> None:
    found = scripts(ws)
    assert set(found) == set(NAMES)
    assert all("ROS_SECURITY_KEYSTORE" in text and str(ws) not in text for text in found.values())
    assert {(ws / "install" / name).stat().st_mode & 0o777 for name in NAMES} == {0o644}


def test_an_existing_keystore_gets_them_and_does_not_change_otherwise(keymint, ws: Path) -> None:
    before = snapshot(ws / "install")
    for name in NAMES:
        (ws / "install" / name).unlink()
    assert keymint("check", "-w", "ws").code == 0
    outcome = keymint("install", "-w", "ws")
    assert (outcome.code, outcome.out) == (0, f"created   install     {', '.join(NAMES)}\n1 created, 4 unchanged\n")
    after = snapshot(ws / "install")
    times = {".", *NAMES}
    assert {path: entry for path, entry in after.items() if path not in times} == {
        path: entry for path, entry in before.items() if path not in times
    }
    assert keymint("install", "-w", "ws").out.startswith("nothing to do")


def test_an_edited_one_is_written_again(keymint, ws: Path) -> None:
    expected, path = scripts(ws), ws / "install/keystore.zsh"
    path.write_text(path.read_text().replace("Enforce", "Permissive"))
    outcome = keymint("install", "-w", "ws")
    assert (outcome.code, scripts(ws)) == (0, expected)
    assert outcome.out == "updated   install     keystore.zsh\n1 updated, 4 unchanged\n"


@pytest.mark.parametrize("make", [lambda path: path.write_text("mine\n"), lambda path: path.symlink_to("/etc/passwd")])
def test_what_somebody_else_wrote_stays(keymint, ws: Path, make) -> None:
    path = ws / "install/keystore.bash"
    path.unlink()
    make(path)
    before = snapshot(ws / "install")
    outcome = keymint("install", "-w", "ws", "--json")
    assert (outcome.code, outcome.codes(), outcome.document["diagnostics"][0]["file"]) == (
        0, ["script-foreign"], "ws/install/keystore.bash"
    )  # fmt: skip
    assert snapshot(ws / "install") == before


def test_a_folder_in_their_place_stays(keymint, ws: Path) -> None:
    path = ws / "install/keystore.fish"
    path.unlink()
    path.mkdir()
    outcome = keymint("install", "-w", "ws", "--json")
    assert (outcome.code, outcome.codes()) == (0, ["script-foreign"])
    assert path.is_dir()


def test_a_dry_run_writes_none(keymint, ws: Path) -> None:
    (ws / "install/keystore.bash").unlink()
    assert "keystore.bash" in keymint("install", "--dry-run", "-w", "ws").out
    assert not (ws / "install/keystore.bash").exists()


def test_without_an_enclave_there_are_none(keymint, ws: Path) -> None:
    for name in NAMES:
        (ws / "install" / name).unlink()
    shutil.rmtree(ws / "src/talker")
    shutil.rmtree(ws / "src/robot1")
    assert "3 removed" in keymint("install", "--prune", "-w", "ws").out
    assert not scripts(ws)


def test_the_second_keystore_has_them_too(keymint, ws: Path) -> None:
    expected = scripts(ws)
    assert keymint("authority", "replace", "identity_ca", "-w", "ws").code == 0
    assert keymint("authority", "replace", "identity_ca", "--phase", "stage", "-w", "ws").code == 0
    assert scripts(ws, "install.next") == expected


def test_of_zenoh_alone(keymint, policy: Path, tmp_path: Path) -> None:
    assert keymint("provision", policy, "-w", "z", "--transport", "zenoh").code == 0
    text = scripts(tmp_path / "z")["keystore.bash"]
    assert "ZENOH_ROUTER_CONFIG_URI=" in text
    assert "ROS_SECURITY" not in text
