# SPDX-License-Identifier: Apache-2.0
"""Authorities: minted once, reissued for the same key, offline, replaced only on request."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from tests.conftest import snapshot
from tests.keymint.stages.keystores import (
    AUTHORITY_KEYS,
    CERTIFICATES,
    ENCLAVES,
    trusted,
)


def test_a_new_authority_takes_the_option(keymint, ws: Path) -> None:
    shutil.copyfile(ws / AUTHORITY_KEYS[1], ws / AUTHORITY_KEYS[0])
    before = trusted(ws)
    dry = snapshot(ws)
    assert keymint("install", "--new-authority", "identity_ca", "--dry-run", cwd=ws).code == 0
    assert snapshot(ws) == dry
    outcome = keymint("install", "--new-authority", "identity_ca", cwd=ws)
    assert outcome.code == 0
    assert "'identity_ca' is a new authority: no deployed enclave trusts it until all are redeployed" in outcome.err
    after = trusted(ws)
    changed = {name for name in before if before[name] != after[name]}
    assert changed == {f"{enclave}/identity_ca.cert.pem" for enclave in ENCLAVES}
    assert keymint("check", cwd=ws).code == 0
    assert keymint("install", cwd=ws).out.startswith("nothing to do")
    (ws / ".keymint/state.json").unlink()
    assert keymint("install", cwd=ws).code == 0


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (("--new-authority", "identity-ca"), 2, "did you mean 'identity_ca'?"),
        (("talker", "--new-authority", "identity_ca"), 2, "do not name packages"),
    ],
)
def test_the_option_is_checked(keymint, ws: Path, words, code: int, said: str) -> None:
    before = snapshot(ws)
    outcome = keymint("install", *words, cwd=ws)
    assert (outcome.code, said in outcome.err) == (code, True), outcome.err
    assert snapshot(ws) == before


def test_longer_validity_keeps_key_and_name(keymint, ws: Path) -> None:
    path = ws / "profile/profile.defaults/authorities.xml"
    path.write_text(path.read_text().replace("<not_after>2037", "<not_after>2038"))
    before = trusted(ws)
    old = [(ws / each).read_bytes() for each in CERTIFICATES]
    keymint("build", cwd=ws)
    outcome = keymint("install", cwd=ws)
    assert outcome.code == 0, outcome.err
    assert outcome.err.count("is reissued for the same key") == 2
    assert trusted(ws) == before
    assert all(each not in old for each in [(ws / each).read_bytes() for each in CERTIFICATES])
    assert keymint("check", cwd=ws).code == 0


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("CN={name}", "CN={name},O=Example", "is for 'CN=identity_ca'"),
        ("SECP256R1", "SECP384R1", "is not an EC key on SECP384R1"),
    ],
)
def test_another_name_or_kind_of_key_is_a_new_authority(keymint, ws: Path, old: str, new: str, said: str) -> None:
    path = ws / "profile/profile.defaults/authorities.xml"
    path.write_text(path.read_text().replace(old, new))
    keymint("build", cwd=ws)
    before = snapshot(ws)
    outcome = keymint("install", cwd=ws)
    assert outcome.code == 1
    assert said in outcome.err
    assert "--new-authority identity_ca" in outcome.err
    assert snapshot(ws) == before
    assert "--new-authority identity_ca" in keymint("check", cwd=ws).err
    both = ("--new-authority", "identity_ca", "--new-authority", "permissions_ca")
    assert keymint("install", *both, cwd=ws).code == 0
    assert keymint("check", cwd=ws).code == 0


def test_a_lost_certificate_is_one_finding_whose_remedy_restores_it(keymint, ws: Path) -> None:
    before = (ws / CERTIFICATES[0]).read_bytes()
    (ws / CERTIFICATES[0]).unlink()
    outcome = keymint("check", cwd=ws)
    assert outcome.code == 3
    (line,) = outcome.err.splitlines()
    assert "'keymint install' restores it" in line
    assert keymint("install", cwd=ws).code == 0
    assert (ws / CERTIFICATES[0]).read_bytes() == before
    assert keymint("check", cwd=ws).code == 0


def test_an_offline_authority_that_lost_its_certificate_is_not_made_again(keymint, ws: Path) -> None:
    for path in (CERTIFICATES[0], AUTHORITY_KEYS[0]):
        (ws / path).unlink()
    before = snapshot(ws)
    outcome = keymint("install", cwd=ws)
    assert outcome.code == 1
    assert "--new-authority identity_ca" in outcome.err
    assert snapshot(ws) == before
    assert "authority-missing" in keymint("check", "--json", cwd=ws).codes()
    shutil.copyfile(ws / "install/enclaves/talker/identity_ca.cert.pem", ws / CERTIFICATES[0])
    assert keymint("install", cwd=ws).out.startswith("nothing to do")
    assert keymint("check", cwd=ws).code == 0


def with_a_root(ws: Path) -> None:
    """Have the identities' authority issued by a third one."""
    path = ws / "profile/authorities.xml"
    path.write_text(
        path.read_text()
        .replace("<authorities>", '<authorities><authority name="root"><cert><issuer_name/></cert></authority>')
        .replace("<issuer_name></issuer_name>", "<issuer_name>root</issuer_name>", 1)
    )


def test_an_authoritys_private_key_may_be_kept_elsewhere(keymint, provisioned: Path) -> None:
    with_a_root(provisioned)
    assert keymint("install", cwd=provisioned).code == 0
    (provisioned / "private/root.key.pem").unlink()
    before = snapshot(provisioned)
    assert keymint("install", cwd=provisioned).out.startswith("nothing to do")
    assert keymint("check", cwd=provisioned).code == 0
    assert keymint("build", "--rekey", "talker", cwd=provisioned).code == 0
    assert keymint("install", cwd=provisioned).code == 0  # the intermediate authority issues
    after = snapshot(provisioned)
    assert {path: after[path] for path in after if path.startswith("public/")} == {
        path: before[path] for path in before if path.startswith("public/")
    }


@pytest.mark.parametrize("name", ["permissions_ca", "identity_ca", "root"])
def test_an_authority_is_not_replaced_because_its_key_is_not_here(keymint, provisioned: Path, name: str) -> None:
    with_a_root(provisioned)
    assert keymint("install", cwd=provisioned).code == 0
    (provisioned / f"private/{name}.key.pem").unlink()
    for part in ("identities", "permissions", "governance"):  # so that everything must be signed again
        path = provisioned / f"profile/package.defaults/{part}.xml"
        path.write_text(
            path.read_text().replace("<not_after>2028-01-14", "<not_after>2028-01-10").replace(">SIGN<", ">ENCRYPT<")
        )
    path = provisioned / "profile/profile.defaults/authorities.xml"
    path.write_text(path.read_text().replace("<hash_algorithm>SHA256", "<hash_algorithm>SHA512"))
    assert keymint("build", cwd=provisioned).code == 0
    before = snapshot(provisioned)
    outcome = keymint("install", cwd=provisioned)
    assert outcome.code == 1
    assert f"the private key of the authority '{name}' is not here" in outcome.err
    assert snapshot(provisioned) == before
    (provisioned / f"public/{name}.cert.pem").unlink()
    outcome = keymint("install", cwd=provisioned)
    assert outcome.code == 1
    assert "has neither key nor certificate here, but enclaves that are installed trust it" in outcome.err
    assert keymint("install", "--new-authority", name, cwd=provisioned).code == 0
