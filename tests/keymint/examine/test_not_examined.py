# SPDX-License-Identifier: Apache-2.0
"""An auditor who may not read ``private/``: verbs that read say what they did not examine."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.conftest import NOW

SOMEBODY = 65534
WITHOUT_PRIVILEGES = """
import ctypes, os, sys
for capability in (1, 2):  # CAP_DAC_OVERRIDE and CAP_DAC_READ_SEARCH: root reads as any other user does
    assert ctypes.CDLL(None).prctl(24, capability, 0, 0, 0) == 0
os.execv(sys.executable, [sys.executable, "-m", "keymint", *sys.argv[1:]])
"""
KEYS = [f"private/{name}" for name in ("identities", "identity_ca.key.pem", "permissions_ca.key.pem")]
EVERYTHING = [*KEYS, "private/register.sqlite3"]
SAFE = "install/enclaves/talker/cert.pem"


@pytest.fixture
def audited(provisioned: Path) -> Path:
    """A workspace whose private space belongs to somebody else."""
    if os.geteuid() != 0:
        pytest.skip("only root gives files to others")
    give(provisioned, "")
    give(provisioned, "private")
    return provisioned


def give(ws: Path, path: str) -> None:
    """Give a file or folder of a workspace to somebody else; the owner of a workspace may own files in it."""
    os.chown(ws / path, SOMEBODY, -1)


def run(ws: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """Run a verb as a user who may read what belongs to root, and what all may read."""
    command = [sys.executable, "-c", WITHOUT_PRIVILEGES, *words]
    environment = {**os.environ, "SOURCE_DATE_EPOCH": str(NOW)}
    return subprocess.run(command, cwd=ws, env=environment, capture_output=True, text=True, check=False)


def document(ws: Path, *words: str) -> dict[str, Any]:
    return json.loads(run(ws, *words, "--json").stdout)


def files(found: dict[str, Any]) -> list[str]:
    """Return the files that were not examined; there is nothing else to report."""
    notes = [each for each in found["diagnostics"] if each["code"] != "assumption"]
    assert {(each["severity"], each["code"]) for each in notes} <= {("note", "not-examined")}
    assert found["result"]["not_examined"] == len(notes)
    return [each["file"] for each in notes]


def test_check(audited: Path) -> None:
    found = document(audited, "check")
    assert (found["exit_code"], files(found)) == (3, ["private"])
    found = document(audited, "check", "--without-private")
    assert (found["exit_code"], files(found)) == (0, ["private"])
    shown = run(audited, "check", "--without-private")
    assert (shown.returncode, "private: note: not examined: " in shown.stderr) == (0, True)
    assert shown.stdout == "checked 2 enclaves: no findings; 1 not examined\n"


def test_a_finding_still_counts(audited: Path) -> None:
    (audited / "install/enclaves/talker/cert.pem").write_bytes(b"")
    found = document(audited, "check", "--without-private")
    assert found["exit_code"] == 3
    assert {"certificate-invalid", "not-examined"} <= {each["code"] for each in found["diagnostics"]}


def test_status(audited: Path, keymint: Callable) -> None:
    before = keymint("status", cwd=audited)
    found, shown = document(audited, "status"), run(audited, "status")
    assert (found["exit_code"], files(found)) == (0, ["private"])
    assert shown.stdout == before.out
    assert "private: note: not examined: " in shown.stderr


def test_prove_does_not_claim_what_the_register_says(audited: Path, keymint: Callable) -> None:
    everything = keymint("prove", "--json", cwd=audited).document["result"]
    assert (everything["in_force"], everything["not_examined"]) == (True, 0)
    found, shown = document(audited, "prove"), run(audited, "prove")
    assert (found["exit_code"], files(found)) == (0, ["private"])
    assert found["result"]["in_force"] is None
    assert found["result"]["until"] == everything["until"]
    assert "18 of 18 claims proven" in shown.stdout
    assert "in force" not in shown.stdout
    assert "valid by their dates at " in shown.stdout
    assert "(whether they were revoked is not known without the register)" in shown.stdout


def test_prove_without_any_register(provisioned: Path, keymint: Callable) -> None:
    """In a copy without ``private/``, too."""
    (provisioned / "private/register.sqlite3").unlink()
    outcome = keymint("prove", "--json", cwd=provisioned)
    assert (outcome.code, outcome.document["result"]["in_force"]) == (0, None)
    assert "in force" not in keymint("prove", cwd=provisioned).out


@pytest.mark.parametrize("verb", ["check", "prove", "status"])
def test_each_file_that_may_not_be_read(audited: Path, verb: str) -> None:
    os.chown(audited / "private", 0, -1)
    for path in (audited / "private").rglob("*"):
        os.chown(path, SOMEBODY, -1)
    assert files(document(audited, verb)) == EVERYTHING


def test_without_the_keys_but_with_the_register(audited: Path) -> None:
    os.chown(audited / "private", 0, -1)
    for path in KEYS:
        give(audited, path)
    found = document(audited, "prove")
    assert (files(found), found["result"]["in_force"]) == (KEYS, True)


def test_a_revoked_enclave_is_not_missing(audited: Path, keymint: Callable) -> None:
    """Its generation in the sources says that it was revoked."""
    assert keymint("revoke", "talker", "--reason", "retired", cwd=audited).code == 0
    found = document(audited, "check", "--without-private")
    assert found["exit_code"] == 0
    assert sorted(each["code"] for each in found["diagnostics"]) == ["identity-revoked", "not-examined"]


@pytest.mark.parametrize("words", [("install",), ("install", "--dry-run"), ("authority", "export", "identity_ca")])
def test_other_verbs_fail_as_before(audited: Path, words: tuple[str, ...]) -> None:
    found = document(audited, *words)
    assert found["exit_code"] == 1
    assert {each["code"] for each in found["diagnostics"]} == {"file-unreadable"}


@pytest.mark.parametrize("verb", ["check", "prove", "status"])
@pytest.mark.parametrize("transport", ["dds", "zenoh"])
def test_keys_of_enclaves_are_unknown(
    keymint: Callable, policy: Path, tmp_path: Path, verb: str, transport: str
) -> None:
    """Everything else is examined: a wrong certificate beside such a key is found."""
    if os.geteuid() != 0:
        pytest.skip("only root gives files to others")
    ws = tmp_path / "ws"
    assert keymint("provision", policy, "-w", ws, "--transport", transport).code == 0
    give(ws, "")
    enclaves = sorted((ws / "install/enclaves").rglob("key.pem"))
    for key in enclaves:
        give(ws, str(key))
    found = document(ws, verb)
    assert (found["exit_code"], files(found)) == (3 if verb == "check" else 0, ["install"])
    assert "private keys of enclaves are not compared" in run(ws, verb).stderr
    shutil.copy(enclaves[0].with_name("cert.pem"), enclaves[1].with_name("cert.pem"))
    found = document(ws, "check", "--without-private")
    assert found["exit_code"] == 3
    assert "error" in {each["severity"] for each in found["diagnostics"]}


@pytest.mark.parametrize("verb", ["check", "prove"])
def test_a_file_of_install_stays_an_error(audited: Path, verb: str) -> None:
    (audited / SAFE).chmod(0o600)
    give(audited, SAFE)
    found = document(audited, verb)
    assert found["exit_code"] != 0
    assert SAFE in {each["file"] for each in found["diagnostics"] if each["severity"] == "error"}


def test_the_option_changes_nothing_for_who_may_read_everything(keymint: Callable, provisioned: Path) -> None:
    (provisioned / "private/identity_ca.key.pem").write_bytes(b"")
    outcome = keymint("check", "--without-private", "--json", cwd=provisioned)
    assert (outcome.code, outcome.codes(), outcome.document["result"]["not_examined"]) == (3, ["key-invalid"], 0)
