"""``keymint check``: every kind of damage is a finding with a stable code."""

from __future__ import annotations

import os
import random
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.conftest import NOW, snapshot

DAY = 86_400


def enclave(ws: Path) -> Path:
    return ws / "install/enclaves/talker"


def test_clean(keymint, provisioned: Path) -> None:
    before = snapshot(provisioned)
    outcome = keymint("check", cwd=provisioned)
    assert outcome.code == 0
    assert outcome.out == "checked 2 enclaves: no findings\n"
    assert outcome.err == ""
    assert snapshot(provisioned) == before


def remove(name: str) -> Callable[[Path], None]:
    return lambda ws: (enclave(ws) / name).unlink()


def mode(name: str, value: int) -> Callable[[Path], None]:
    return lambda ws: (ws / name).chmod(value)


def swap_key(ws: Path) -> None:
    shutil.copyfile(ws / "install/enclaves/robot1/listener/key.pem", enclave(ws) / "key.pem")


def swap_enclave(name: str) -> Callable[[Path], None]:
    """A whole signed file of another enclave: sound in itself, but not this subject's."""
    return lambda ws: shutil.copyfile(ws / "install/enclaves/robot1/listener" / name, enclave(ws) / name)


def plant_ca_key(ws: Path) -> None:
    shutil.copyfile(ws / "private/permissions_ca.key.pem", ws / "install/public/permissions_ca.key.pem")


def link(ws: Path) -> None:
    path = enclave(ws) / "identity_ca.cert.pem"
    path.unlink()
    path.symlink_to("../../public/identity_ca.cert.pem")


def edit_source(ws: Path) -> None:
    path = ws / "src/talker/permissions.xml"
    path.write_text(path.read_text().replace("/chatter", "/other"))


def widen_governance(ws: Path) -> None:
    path = ws / "profile/package.defaults/permissions.xml"
    path.write_text(path.read_text().replace("<id>0</id>", "<id>0</id><id>5</id>"))


def uninstall(ws: Path) -> None:
    shutil.rmtree(enclave(ws))


@pytest.mark.parametrize(
    "damage",
    [
        *[
            remove(name)
            for name in ("cert.pem", "key.pem", "governance.p7s", "permissions.p7s", "permissions_ca.cert.pem")
        ],
        mode("install/enclaves/talker/key.pem", 0o644),
        mode("install/enclaves/talker", 0o755),
        mode("private/identity_ca.key.pem", 0o640),
        mode("private", 0o755),
        swap_key,
        *[swap_enclave(name) for name in ("cert.pem", "permissions.p7s", "permissions.xml")],
        plant_ca_key,
        link,
        edit_source,
        widen_governance,
        uninstall,
    ],
)
def test_damage_is_found(keymint, provisioned: Path, damage: Callable[[Path], None]) -> None:
    damage(provisioned)
    outcome = keymint("check", "--json", cwd=provisioned)
    assert outcome.code == 3
    for finding in outcome.document["diagnostics"]:
        assert finding["code"]
        assert "\n" not in finding["message"] + finding["help"]


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
        for at in {0, len(content) - 1, *chance.sample(range(len(content)), 4)}:
            flipped = bytearray(content)
            flipped[at] ^= 1 << chance.randrange(8)
            path.write_bytes(flipped)
            outcome = keymint("check", cwd=provisioned)
            assert outcome.code == 3, f"{path.name}, byte {at}: {outcome.err}"
        path.write_bytes(content)
    assert keymint("check", cwd=provisioned).code == 0


@pytest.mark.parametrize(
    ("later", "within", "code"),
    [(0, "0d", 0), (0, "30d", 0), (0, "400d", 3), (350, "30d", 3), (400, "0d", 3), (5000, "0d", 3), (-10, "0d", 3)],
)
def test_validity(keymint, provisioned: Path, later: int, within: str, code: int) -> None:
    outcome = keymint("check", "--within", within, cwd=provisioned, env={"SOURCE_DATE_EPOCH": str(NOW + later * DAY)})
    assert outcome.code == code, outcome.err


@pytest.mark.parametrize("text", ["soon", "30", "-1d", "1y", "999999w"])
def test_a_period_that_is_none(keymint, provisioned: Path, text: str) -> None:
    outcome = keymint("check", "--within", text, cwd=provisioned)
    assert outcome.code == 2


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


def test_one_authority_for_both_jobs(keymint, policy: Path, tmp_path: Path) -> None:
    """A finding where it can be mended; a note in the layout that has no place for a second one."""
    assert keymint("provision", policy, "-w", "flat", "--layout", "flat").code == 0
    outcome = keymint("check", "-w", "flat", "--json")
    assert outcome.code == 0
    assert [(d["code"], d["severity"]) for d in outcome.document["diagnostics"]] == [("authority-shared", "note")]
    profile = tmp_path / "flat/profile/keymint_profile.xml"
    profile.write_text(profile.read_text().replace("<layout>flat</layout>", "<layout>sros2</layout>"))
    assert keymint("install", "-w", "flat").code == 0
    outcome = keymint("check", "-w", "flat", "--json")
    assert outcome.code == 3
    assert "authority-shared" in outcome.codes()


def test_an_authority_of_someone_else(keymint, provisioned: Path, policy: Path, tmp_path: Path) -> None:
    """An enclave whose authorities are sound, but not those of this workspace."""
    assert keymint("provision", policy, "-w", "foreign").code == 0
    for path in (tmp_path / "foreign/install/enclaves/talker").iterdir():
        shutil.copyfile(path, enclave(provisioned) / path.name)
    assert keymint("check", cwd=provisioned).code == 3
    (provisioned / ".keymint/state.json").unlink()
    assert keymint("check", cwd=provisioned).code == 3


def test_a_package_that_is_not_installed(keymint, provisioned: Path) -> None:
    uninstall(provisioned)
    outcome = keymint("check", "talker", cwd=provisioned)
    assert outcome.code == 3
    assert "the enclave /talker is not installed (run 'keymint install talker')" in outcome.err


def test_a_file_that_cannot_be_read(keymint, provisioned: Path) -> None:
    if os.geteuid() == 0:
        pytest.skip("root reads everything")
    (enclave(provisioned) / "cert.pem").chmod(0)
    outcome = keymint("check", cwd=provisioned)
    assert outcome.code in {1, 3}
    assert "Traceback" not in outcome.err


def test_without_the_password_of_an_authority(keymint, provisioned: Path) -> None:
    path = provisioned / "profile/authorities.xml"
    root = (
        '<authority name="root"><cert><issuer_name/></cert>'
        "<key><asymmetric_type><ec><curve>SECP256R1</curve></ec></asymmetric_type><encryption_algorithm>BestAvailableEncryption</encryption_algorithm>"
        "<password_env>ROOT_PASSWORD</password_env></key></authority>"
    )
    path.write_text(
        path.read_text()
        .replace("<authorities>", f"<authorities>{root}")
        .replace("<issuer_name></issuer_name>", "<issuer_name>root</issuer_name>", 1)
    )
    environment = {"ROOT_PASSWORD": "correct horse"}
    assert keymint("install", cwd=provisioned, env=environment).code == 0
    assert keymint("check", cwd=provisioned, env=environment).code == 0
    without = keymint("check", "--json", cwd=provisioned)
    assert (without.code, without.codes()) == (0, ["password-missing"])
    wrong = keymint("check", "--json", cwd=provisioned, env={"ROOT_PASSWORD": "wrong"})
    assert (wrong.code, wrong.codes()) == (3, ["key-password"])
