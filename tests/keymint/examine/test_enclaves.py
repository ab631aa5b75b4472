# SPDX-License-Identifier: Apache-2.0
"""``keymint check`` of single enclaves."""

from __future__ import annotations

import os
import random
import shutil
from pathlib import Path

import pytest

from tests.effort import tries


@pytest.mark.parametrize("recorded", [True, False])
def test_any_flipped_byte_in_any_installed_file_is_found(keymint, provisioned: Path, *, recorded: bool) -> None:
    """With the record, and by looking at the files alone."""
    chance = random.Random(20261121)
    if not recorded:
        (provisioned / ".keymint/state.json").unlink()
    for path in sorted((provisioned / "install").rglob("*")):
        if not path.is_file() or path.name == ".gitignore":  # which is the user's to edit
            continue
        content = path.read_bytes()
        for at in {0, len(content) - 1, *chance.sample(range(len(content)), tries(1, 4))}:
            flipped = bytearray(content)
            flipped[at] ^= 1 << chance.randrange(8)
            path.write_bytes(flipped)
            outcome = keymint("check", cwd=provisioned)
            assert outcome.code == 3, f"{path.name}, byte {at}: {outcome.err}"
        path.write_bytes(content)
    assert keymint("check", cwd=provisioned).code == 0


def test_a_package_that_is_not_installed(keymint, provisioned: Path) -> None:
    shutil.rmtree(provisioned / "install/enclaves/talker")
    outcome = keymint("check", "talker", cwd=provisioned)
    assert outcome.code == 3
    assert "the enclave /talker is not installed (run 'keymint install talker')" in outcome.err


def test_a_file_that_belongs_to_no_build_type(keymint, provisioned: Path) -> None:
    """A revocation list, which Keymint does not write, belongs to the enclave."""
    for name in ("notes.txt", "crl.pem"):
        (provisioned / "install/enclaves/talker" / name).touch()
    found = keymint("check", "--json", cwd=provisioned).document["diagnostics"]
    [unexpected] = [each for each in found if each["code"] == "file-unexpected"]
    assert unexpected["file"] == "install/enclaves/talker/notes.txt"
    assert unexpected["message"] == "does not belong to the layout 'sros2'"
    assert unexpected["subject"] == "/talker"


def test_a_file_that_cannot_be_read(keymint, provisioned: Path) -> None:
    if os.geteuid() == 0:
        pytest.skip("root reads everything")
    (provisioned / "install/enclaves/talker" / "cert.pem").chmod(0)
    outcome = keymint("check", cwd=provisioned)
    assert outcome.code in {1, 3}
    assert "Traceback" not in outcome.err


def test_names_that_a_vendor_confuses(keymint, tmp_path: Path) -> None:
    """On Cyclone DDS the certificate CN=/robot matches the grant of CN=/robot/camera."""
    (tmp_path / "p.xml").write_text(
        "<profiles><profile name='a'><attachments><attachment>/robot</attachment>"
        "<attachment>/robot/camera</attachment></attachments></profile></profiles>"
    )
    assert keymint("provision", "p.xml", "-w", "bare", "--subject-format", "sros2").code == 0
    outcome = keymint("check", "-w", "bare")
    assert outcome.code == 3
    assert "/robot" in outcome.err
    assert "Cyclone" in outcome.err
    assert keymint("provision", "p.xml", "-w", "unique").code == 0
    assert keymint("check", "-w", "unique").code == 0
