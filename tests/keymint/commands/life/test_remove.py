# SPDX-License-Identifier: Apache-2.0
"""``keymint remove``: package, enclave and key go, and the certificate is revoked."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.conftest import snapshot


@pytest.fixture
def renamed(provisioned: Path) -> Path:
    """A workspace whose policy does not name ``/talker`` any more, but another subject."""
    policy = provisioned.parent / "policy.xml"
    policy.write_text(policy.read_text().replace("<attachment>/talker<", "<attachment>/speaker<"))
    return provisioned


def parts(ws: Path) -> set[str]:
    """Return the spaces that have anything of ``/talker``."""
    return {path.relative_to(ws).parts[0] for path in ws.rglob("talker") if path.is_dir()}


def in_force(keymint: Callable, ws: Path) -> set[str]:
    found = keymint("issued", "--json", cwd=ws).document["result"]["certificates"]
    return {each["subject"] for each in found if each["revoked"] is None}


def test_all_of_a_package_goes(keymint: Callable, renamed: Path) -> None:
    assert parts(renamed) == {"src", "build", "install", "private"}
    removed = keymint("remove", "/talker", "--json", cwd=renamed)
    assert removed.code == 0, removed.out
    result = removed.document["result"]
    assert (result["removed"], result["restart"]) == (["/talker"], ["/robot1/listener"])
    assert [each["subject"] for each in result["revoked"]] == ["/talker"]
    assert parts(renamed) == set()
    certificates = keymint("issued", "talker", "--json", cwd=renamed).document["result"]["certificates"]
    assert [each["reason"] for each in certificates] == ["retired"]
    assert (renamed / "install/enclaves/robot1/listener/crl.pem").exists()
    assert keymint("check", cwd=renamed).code == 0
    assert in_force(keymint, renamed) == {"/robot1/listener"}
    assert keymint("provision", "../policy.xml", "-w", ".", cwd=renamed).code == 0
    assert keymint("check", cwd=renamed).code == 0


@pytest.mark.parametrize("how", ["remove", "prune"])
def test_the_last_enclaves_leave_nothing_behind(keymint: Callable, renamed: Path, how: str) -> None:
    """What all enclaves share, and the scripts, were left, and ``check`` reported them."""
    if how == "prune":
        shutil.rmtree(renamed / "src/talker")
        shutil.rmtree(renamed / "src/robot1")
        outcome = keymint("install", "--prune", cwd=renamed)
    else:
        policy = renamed.parent / "policy.xml"
        policy.write_text(policy.read_text().replace("<attachment>/robot1/listener<", "<attachment>/hearer<"))
        assert keymint("remove", "/talker", cwd=renamed).code == 0
        assert (renamed / "install/keystore.bash").exists()
        outcome = keymint("remove", "/robot1/listener", cwd=renamed)
    assert outcome.code in {0, 3}, outcome.err
    assert "shared by all enclaves; none is left" in outcome.out
    assert [path.name for path in (renamed / "install").rglob("*") if path.is_file()] == [".gitignore"]
    assert "file-unexpected" not in keymint("check", "--json", cwd=renamed).codes()


def test_a_package_that_comes_back_has_a_new_key_and_generation(keymint: Callable, renamed: Path) -> None:
    key = (renamed / "private/identities/talker/key.pem").read_bytes()
    policy = renamed.parent / "policy.xml"
    assert keymint("remove", "talker", cwd=renamed).code == 0
    policy.write_text(policy.read_text().replace("/speaker<", "/talker<"))
    assert keymint("provision", policy, "-w", renamed).code == 0
    assert (renamed / "private/identities/talker/key.pem").read_bytes() != key
    certificates = keymint("issued", "talker", "--json", cwd=renamed).document["result"]["certificates"]
    assert [each["generation"] for each in certificates] == [0, 1]


def test_what_the_policy_names_is_refused_with_its_line(keymint: Callable, provisioned: Path) -> None:
    before = snapshot(provisioned)
    refused = keymint("remove", "talker", "/robot1/listener", "--json", cwd=provisioned)
    assert (refused.code, refused.codes()) == (1, ["still-named", "still-named"])
    line = refused.document["diagnostics"][0]["line"]
    assert "/talker" in (provisioned.parent / "policy.xml").read_text().splitlines()[line - 1]
    assert snapshot(provisioned) == before


def test_what_was_never_deployed_is_not_revoked(keymint: Callable, renamed: Path) -> None:
    assert keymint("remove", "talker", "--never-deployed", cwd=renamed).code == 0
    assert parts(renamed) == set()
    assert not (renamed / "public/identity_ca.crl.pem").exists()
    assert keymint("check", cwd=renamed).code == 0


def test_a_dry_run_writes_nothing(keymint: Callable, renamed: Path) -> None:
    before = snapshot(renamed)
    shown = keymint("remove", "talker", "--dry-run", cwd=renamed)
    assert (shown.code, "would revoke /talker" in shown.out) == (0, True)
    assert snapshot(renamed) == before


@pytest.mark.parametrize("gone", ["src", "build", "install/enclaves", "private/identities"])
def test_what_is_left_of_a_package_goes_too(keymint: Callable, renamed: Path, gone: str) -> None:
    shutil.rmtree(renamed / gone / "talker")
    assert keymint("remove", "talker", cwd=renamed).code == 0
    assert parts(renamed) == set()
    assert in_force(keymint, renamed) == {"/robot1/listener"}
    before = snapshot(renamed / "private")
    again = keymint("remove", "talker", "--json", cwd=renamed)
    assert (again.code, again.document["result"]["removed"]) == (0, [])
    assert snapshot(renamed / "private") == before
    refused = keymint("remove", "/t*", "--json", cwd=renamed)
    assert refused.codes() == ["package-unknown"]


def test_packages_below_it_stay(keymint: Callable, provisioned: Path) -> None:
    policy = provisioned.parent / "policy.xml"
    text = policy.read_text()
    policy.write_text(text.replace("<attachment>/talker<", "<attachment>/robot1<"))
    assert keymint("provision", policy, "-w", provisioned, "--yes").code == 0
    policy.write_text(text)
    assert keymint("remove", "robot1", cwd=provisioned).code == 0
    assert not (provisioned / "src/robot1/keymint_package.xml").exists()
    assert (provisioned / "src/robot1/listener/keymint_package.xml").exists()
    assert keymint("provision", policy, "-w", provisioned).code == 0
    assert keymint("check", cwd=provisioned).code == 0


def test_a_pattern_lists_what_it_stands_for(keymint: Callable, renamed: Path) -> None:
    stopped = keymint("remove", "/t*", "--json", cwd=renamed)
    assert (stopped.code, stopped.codes()) == (3, ["names-by-pattern", "not-confirmed"])
    assert parts(renamed) == {"src", "build", "install", "private"}
    assert keymint("remove", "/t*", "--yes", cwd=renamed).code == 0


def test_the_routers_file_loses_its_rights(keymint: Callable, policy: Path, tmp_path: Path) -> None:
    assert keymint("provision", policy, "-w", "ws", "--transport", "zenoh").code == 0
    router = tmp_path / "ws/install/zenoh/router.json5"
    assert "talker" in router.read_text()
    policy.write_text(policy.read_text().replace("<attachment>/talker<", "<attachment>/speaker<"))
    assert keymint("remove", "talker", "-w", "ws").code == 0
    assert "talker" not in router.read_text()
    assert keymint("check", "-w", "ws").code == 0
    refused = keymint("remove", "zenoh_router", "-w", "ws", "--json")
    assert refused.codes() == ["package-needed"]
    assert "'keymint renew --rekey zenoh_router -w ws'" in refused.document["diagnostics"][0]["help"]


def test_prune_names_the_packages_that_nobody_needs(keymint: Callable, renamed: Path) -> None:
    for _ in range(2):
        pruned = keymint("provision", "../policy.xml", "-w", ".", "--prune", "--yes", cwd=renamed)
        assert (pruned.code, "'keymint remove /talker'" in pruned.err) == (0, True)
    assert keymint("remove", "talker", cwd=renamed).code == 0
    assert "remove" not in keymint("provision", "../policy.xml", "-w", ".", "--prune", cwd=renamed).err
