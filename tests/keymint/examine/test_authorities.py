# SPDX-License-Identifier: Apache-2.0
"""``keymint check`` of authorities: shared, foreign, or without a password."""

from __future__ import annotations

import shutil
from pathlib import Path

from tests.conftest import NOW


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
        shutil.copyfile(path, provisioned / "install/enclaves/talker" / path.name)
    assert keymint("check", cwd=provisioned).code == 3
    (provisioned / ".keymint/state.json").unlink()
    assert keymint("check", cwd=provisioned).code == 3


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


def test_an_authority_that_is_not_valid_yet(keymint, provisioned: Path) -> None:
    """The clock of this machine is years behind; no proof is needed to say so."""
    outcome = keymint("check", "--no-prove", "--json", cwd=provisioned, env={"SOURCE_DATE_EPOCH": str(NOW // 2)})
    found = [each for each in outcome.document["diagnostics"] if each["code"] == "authority-not-yet-valid"]
    assert {each["file"] for each in found} == {f"public/{name}_ca.cert.pem" for name in ("identity", "permissions")}


def test_a_certificate_that_no_enclave_rests_on_has_one_block(keymint, made: Path, provisioned: Path) -> None:
    shutil.rmtree(provisioned / "install")
    own = provisioned / "public/identity_ca.cert.pem"
    foreign = (made / "foreign/public/identity_ca.cert.pem").read_bytes()
    own.write_bytes(own.read_bytes() + foreign.replace(b"CERTIFICATE", b"X509 CRL"))
    found = keymint("check", "--no-prove", "--json", cwd=provisioned).document["diagnostics"]
    assert [each["code"] for each in found if each["file"] == "public/identity_ca.cert.pem"] == [
        "certificate-ambiguous"
    ]
