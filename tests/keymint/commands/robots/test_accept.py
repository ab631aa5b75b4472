# SPDX-License-Identifier: Apache-2.0
"""``keymint accept``, with bundles that the other verbs make: what a carrier may try, and what a robot ends up with."""

from __future__ import annotations

import json
import os
import shutil
import stat
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from comarmor.errors import Origin
from keymint.robots.bundle import pack, unpack
from tests.conftest import CHECKOUT, NOW, snapshot

DAY = 86_400


def ran(keymint, *arguments: object, env: dict[str, str] | None = None) -> dict[str, Any]:
    outcome = keymint(*arguments, "--json", env=env)
    assert outcome.code == 0, outcome.out
    return outcome.document["result"]


def code(outcome) -> str:
    assert outcome.code == 1, outcome.out + outcome.err
    [found] = outcome.codes()
    return found


def authority(bundle: Path) -> str:
    """Return the fingerprint of the authority of a bundle."""
    return json.loads(unpack(bundle.read_bytes(), Origin("b"))["manifest.json"])["authority"]


def requested(keymint, name: str, keystore: str, *more: str) -> None:
    """Let a robot ask for an enclave, and the authority sign it."""
    file = f"{name.replace('/', '.')}.request.pem"
    asked = ran(keymint, "request", name, "--folder", keystore, *more)
    confirmed = () if asked["signed_by_current_key"] else ("--fingerprint", f"{name}={asked['fingerprint']}")
    ran(keymint, "sign", file, "-w", "ws", *confirmed)


@pytest.fixture
def trust(keymint, ws: Path, tmp_path: Path) -> str:
    """The fingerprint of the authority, as its owner reads it."""
    ran(keymint, "bundle", "talker", "-w", "ws", "-o", "first")
    trusted = authority(tmp_path / "first")
    (tmp_path / "first").unlink()
    return trusted


@pytest.fixture
def robot(keymint, trust: str, tmp_path: Path) -> Path:
    """The keystore of a robot that made its key itself."""
    requested(keymint, "talker", "robot")
    ran(keymint, "accept", "talker.bundle", "--folder", "robot", "--authority-fingerprint", trust)
    return tmp_path / "robot"


def test_an_enclave_by_request(keymint, robot: Path, ws: Path) -> None:
    folder = robot / "enclaves/talker"
    of_authority = {path.name: path.read_bytes() for path in (ws / "install/enclaves/talker").iterdir()}
    assert "key.pem" not in of_authority
    there = {path.name: path.read_bytes() for path in folder.iterdir()}
    assert there.keys() == {*of_authority, "key.pem", "bundle.json"}
    assert {name: there[name] for name in of_authority} == of_authority
    assert stat.S_IMODE((folder / "key.pem").stat().st_mode) == 0o600
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert not (robot / ".keymint/requests").exists() or not any((robot / ".keymint/requests").rglob("*.pem"))
    assert keymint("check", "-w", "ws").out.startswith("checked 2 enclaves")


def test_openssl_accepts_the_enclave(keymint, robot: Path) -> None:
    folder = robot / "enclaves/talker"
    for command in (
        f"verify -attime {NOW} -x509_strict -CAfile identity_ca.cert.pem cert.pem",
        f"smime -verify -attime {NOW} -text -in permissions.p7s -CAfile permissions_ca.cert.pem -out /dev/null",
        "pkey -in key.pem -pubout -out /dev/null",
    ):
        subprocess.run(["openssl", *command.split()], cwd=folder, check=True, capture_output=True)
    public = [
        subprocess.run(["openssl", *command], cwd=folder, check=True, capture_output=True).stdout
        for command in (["pkey", "-in", "key.pem", "-pubout"], ["x509", "-in", "cert.pem", "-noout", "-pubkey"])
    ]
    assert public[0] == public[1]


def test_the_same_bundle_again_changes_nothing(keymint, robot: Path) -> None:
    before = snapshot(robot / "enclaves")
    result = ran(keymint, "accept", "talker.bundle", "--folder", "robot")
    assert (result["restart"], result["enclaves"][0]["action"]) == ([], "unchanged")
    assert snapshot(robot / "enclaves") == before


def test_a_dry_run_changes_nothing(keymint, trust: str, tmp_path: Path) -> None:
    requested(keymint, "talker", "robot")
    before = snapshot(tmp_path / "robot")
    trusting = ("--authority-fingerprint", trust)
    assert ran(keymint, "accept", "talker.bundle", "--folder", "robot", *trusting, "--dry-run")["restart"]
    assert snapshot(tmp_path / "robot") == before


def test_a_changed_policy_needs_no_request(keymint, robot: Path, ws: Path) -> None:
    key = (robot / "enclaves/talker/key.pem").read_bytes()
    certificate = (robot / "enclaves/talker/cert.pem").read_bytes()
    policy = (ws.parent / "policy.xml").read_text().replace("/chatter", "/chat")
    (ws.parent / "policy.xml").write_text(policy)
    assert keymint("provision", "policy.xml", "-w", "ws").code == 0
    ran(keymint, "bundle", "talker", "-w", "ws")
    assert ran(keymint, "accept", "talker.bundle", "--folder", "robot")["restart"] == ["/talker"]
    folder = robot / "enclaves/talker"
    assert b"rt/chat" in (folder / "permissions.xml").read_bytes()
    assert ((folder / "key.pem").read_bytes(), (folder / "cert.pem").read_bytes()) == (key, certificate)


def test_a_new_key_by_request(keymint, robot: Path) -> None:
    old = (robot / "enclaves/talker/key.pem").read_bytes()
    requested(keymint, "talker", "robot", "--rekey")
    assert ran(keymint, "accept", "talker.bundle", "--folder", "robot")["enclaves"][0]["answers_request"]
    assert (robot / "enclaves/talker/key.pem").read_bytes() != old


def test_a_renewed_enclave_gets_a_bundle_that_needs_no_request(keymint, robot: Path) -> None:
    folder = robot / "enclaves/talker"
    before = {name: (folder / name).read_bytes() for name in ("key.pem", "cert.pem", "permissions.p7s")}
    later = {"SOURCE_DATE_EPOCH": str(NOW + 300 * DAY)}
    assert keymint("renew", "-w", "ws", env=later).code == 0
    ran(keymint, "bundle", "talker", "-w", "ws", env=later)
    [taken] = ran(keymint, "accept", "talker.bundle", "--folder", "robot", env=later)["enclaves"]
    assert taken["not_after"] > "2028-06"
    after = {name: (folder / name).read_bytes() for name in before}
    assert {name for name in before if before[name] == after[name]} == {"key.pem"}


def test_a_revoked_enclave_gets_a_bundle_that_needs_no_request(keymint, robot: Path, ws: Path) -> None:
    assert keymint("revoke", "talker", "--reason", "superseded", "-w", "ws").code == 0
    ran(keymint, "bundle", "/**", "-w", "ws")
    result = ran(keymint, "accept", "talker.bundle", "robot1.listener.bundle", "--folder", "robot", "--new")
    found = {each["enclave"]: (each["generation"], each["revocations"]) for each in result["enclaves"]}
    assert found == {"/talker": (1, 1), "/robot1/listener": (0, 1)}
    assert (robot / "enclaves/talker/crl.pem").read_bytes() == (ws / "public/identity_ca.crl.pem").read_bytes()


# -- what a carrier may try ------------------------------------------------------------------------------------------


def test_an_old_bundle_is_not_taken_again(keymint, robot: Path, tmp_path: Path) -> None:
    shutil.copy(tmp_path / "talker.bundle", tmp_path / "kept.bundle")
    assert keymint("revoke", "talker", "--reason", "superseded", "-w", "ws").code == 0
    ran(keymint, "bundle", "talker", "-w", "ws")
    ran(keymint, "accept", "talker.bundle", "--folder", "robot")
    before = snapshot(robot / "enclaves")
    assert code(keymint("accept", "kept.bundle", "--folder", "robot", "--json")) == "bundle-outdated"
    assert snapshot(robot / "enclaves") == before


def test_numbers_rise_although_the_register_was_lost(keymint, robot: Path, ws: Path) -> None:
    (ws / "private/register.sqlite3").unlink()
    later = {"SOURCE_DATE_EPOCH": str(NOW + 60)}
    ran(keymint, "bundle", "talker", "-w", "ws", env=later)
    ran(keymint, "accept", "talker.bundle", "--folder", "robot", env=later)


def test_the_bundle_of_another_robot(keymint, robot: Path, trust: str, tmp_path: Path) -> None:
    """Two robots ask for one name; the bundles are mixed up."""
    (tmp_path / "talker.bundle").rename(tmp_path / "one.bundle")
    asked = ran(keymint, "request", "talker", "--folder", "other")
    ran(keymint, "sign", "talker.request.pem", "-w", "ws", "--fingerprint", f"talker={asked['fingerprint']}")
    before = snapshot(robot)
    assert code(keymint("accept", "talker.bundle", "--folder", "robot", "--json")) == "bundle-nonce"
    assert snapshot(robot) == before
    trusting = ("--authority-fingerprint", trust)
    assert code(keymint("accept", "one.bundle", "--folder", "other", *trusting, "--json")) == "bundle-nonce"
    ran(keymint, "bundle", "talker", "-w", "ws")  # answers no request, and is for the key of the other robot
    assert code(keymint("accept", "talker.bundle", "--folder", "robot", "--json")) == "bundle-key"


def test_a_bundle_of_another_authority(keymint, robot: Path, made: Path, tmp_path: Path) -> None:
    shutil.copytree(made / "foreign", tmp_path / "foreign")
    ran(keymint, "bundle", "/talker", "-w", "foreign", "-o", "foreign.bundle")
    before = snapshot(robot)
    assert code(keymint("accept", "foreign.bundle", "--folder", "robot", "--json")) == "bundle-authority"
    assert snapshot(robot) == before
    refused = keymint("accept", "foreign.bundle", "--folder", "nowhere", "--new", "--json")
    assert code(refused) == "bundle-authority"
    wrong = "0" * 64
    trusting = ("--authority-fingerprint", wrong)
    refused = keymint("accept", "foreign.bundle", "--folder", "nowhere", "--new", *trusting, "--json")
    assert code(refused) == "bundle-authority"
    message = refused.document["diagnostics"][0]["message"]
    assert f"does not match {wrong}" in message
    assert "trusts no authority yet" not in message
    assert not (tmp_path / "nowhere").exists()
    assert authority(tmp_path / "foreign.bundle") not in refused.out  # nobody should copy it from here


def test_one_bad_bundle_among_good_ones_changes_nothing(keymint, robot: Path, tmp_path: Path) -> None:
    ran(keymint, "bundle", "/**", "-w", "ws")
    listener = tmp_path / "robot1.listener.bundle"
    listener.write_bytes(listener.read_bytes()[:-1])
    before = snapshot(robot)
    outcome = keymint("accept", "talker.bundle", "robot1.listener.bundle", "--folder", "robot", "--new", "--json")
    assert code(outcome) == "bundle-form"
    assert outcome.document["diagnostics"][0]["file"] == "robot1.listener.bundle"
    assert snapshot(robot) == before


def test_two_bundles_for_one_enclave(keymint, robot: Path, tmp_path: Path) -> None:
    shutil.copy(tmp_path / "talker.bundle", tmp_path / "again.bundle")
    outcome = keymint("accept", "talker.bundle", "again.bundle", "--folder", "robot", "--json")
    assert code(outcome) == "bundle-twice"


def test_a_clock_that_is_wrong_says_so(keymint, robot: Path) -> None:
    ran(keymint, "bundle", "talker", "-w", "ws")
    outcome = keymint("accept", "talker.bundle", "--folder", "robot", "--json", env={"SOURCE_DATE_EPOCH": "0"})
    assert code(outcome) == "bundle-dates"
    assert "1970-01-01" in outcome.out


@pytest.mark.parametrize(
    ("content", "expected"),
    [(b"", "bundle-form"), (b"x", "bundle-form"), (pack({}), "bundle-manifest")],
    ids=["empty", "garbage", "an empty archive"],
)
def test_files_that_are_no_bundles(keymint, tmp_path: Path, content: bytes, expected: str) -> None:
    (tmp_path / "x.bundle").write_bytes(content)
    assert code(keymint("accept", "x.bundle", "--folder", "robot", "--json")) == expected
    assert not (tmp_path / "robot").exists()


def test_a_huge_file_is_not_read(keymint, tmp_path: Path) -> None:
    with (tmp_path / "x.bundle").open("wb") as file:
        file.truncate(1 << 40)
    assert code(keymint("accept", "x.bundle", "--folder", "robot", "--json")) == "file-size"


def test_a_link_in_the_keystore_is_not_followed(keymint, trust: str, tmp_path: Path) -> None:
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "robot").mkdir()
    (tmp_path / "robot/enclaves").symlink_to(tmp_path / "elsewhere")
    ran(keymint, "bundle", "robot1/listener", "-w", "ws")
    outcome = keymint(
        "accept", "robot1.listener.bundle", "--folder", "robot", "--new", "--authority-fingerprint", trust, "--json"
    )
    assert code(outcome) == "symlink-refused"
    assert list((tmp_path / "elsewhere").iterdir()) == []


@pytest.mark.parametrize("given", ["12", "x" * 64, "", "0" * 63])
def test_a_fingerprint_is_typed_completely(keymint, robot: Path, given: str) -> None:
    outcome = keymint("accept", "talker.bundle", "--folder", "robot", "--authority-fingerprint", given)
    assert outcome.code == 2


def test_a_fingerprint_may_be_typed_in_groups(keymint, trust: str) -> None:
    requested(keymint, "talker", "robot")
    typed = ":".join(trust[at : at + 2] for at in range(0, 64, 2)).upper()
    ran(keymint, "accept", "talker.bundle", "--folder", "robot", "--authority-fingerprint", typed)


def test_an_enclave_around_another_one(keymint, trust: str, tmp_path: Path) -> None:
    """The folder of /robot1 contains that of /robot1/listener, which stays."""
    policy = (tmp_path / "policy.xml").read_text().replace(">/talker<", ">/robot1<")
    (tmp_path / "policy.xml").write_text(policy)
    assert keymint("provision", "policy.xml", "-w", "ws", "--yes").code == 0
    ran(keymint, "bundle", "robot1/listener", "robot1", "-w", "ws")
    trusting = ("--folder", "robot", "--authority-fingerprint", trust, "--new")
    ran(keymint, "accept", "robot1.listener.bundle", *trusting)
    before = snapshot(tmp_path / "robot/enclaves/robot1/listener")
    ran(keymint, "accept", "robot1.bundle", *trusting)
    assert snapshot(tmp_path / "robot/enclaves/robot1/listener") == before
    assert (tmp_path / "robot/enclaves/robot1/cert.pem").exists()


def test_it_starts_without_what_only_workspaces_need(tmp_path: Path) -> None:
    script = (
        "import sys\nfrom keymint import cli\ncode = cli.main(['accept', 'x.bundle', '--folder', 'robot'])\n"
        "print(code, sorted({'lxml', 'sqlite3', 'jinja2', 'rich', 'keymint_ros', 'pyjson5'} & set(sys.modules)))"
    )
    (tmp_path / "x.bundle").write_bytes(b"x")
    environment = {**os.environ, "PYTHONPATH": str(CHECKOUT)}
    done = subprocess.run(
        [sys.executable, "-c", script], cwd=tmp_path, env=environment, capture_output=True, text=True, check=True
    )
    assert done.stdout.splitlines() == ["1 []"]


def test_an_old_bundle_that_a_list_of_another_enclave_revokes(keymint, trust: str, ws: Path, tmp_path: Path) -> None:
    ran(keymint, "bundle", "talker", "-w", "ws", "-o", "old.bundle")
    ran(keymint, "revoke", "talker", "--reason", "retired", "-w", "ws")
    ran(keymint, "bundle", "robot1/listener", "-w", "ws")
    ran(keymint, "accept", "robot1.listener.bundle", "--folder", "r", "--new", "--authority-fingerprint", trust)
    before = snapshot(tmp_path / "r")
    assert code(keymint("accept", "old.bundle", "--folder", "r", "--new", "--json")) == "bundle-revoked"
    assert snapshot(tmp_path / "r") == before
    ran(keymint, "renew", "--rekey", "talker", "-w", "ws")
    ran(keymint, "bundle", "talker", "-w", "ws")
    ran(keymint, "accept", "talker.bundle", "--folder", "r", "--new")


def test_a_damaged_list_of_another_enclave_keeps_none_out(keymint, robot: Path, ws: Path) -> None:
    ran(keymint, "bundle", "robot1/listener", "-w", "ws")
    (robot / "enclaves/talker/crl.pem").write_bytes(b"-----BEGIN X509 CRL-----\nx\n")
    ran(keymint, "accept", "robot1.listener.bundle", "--folder", "robot", "--new")
