# SPDX-License-Identifier: Apache-2.0
"""Keys that others could read before 'keymint adopt' took them over: a finding until they are replaced."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path

import pytest

from tests.conftest import NOW
from tests.keymint.commands.exchange.test_adopt import made

MODES = {"private/ca.key.pem": 0o644, "enclaves/talker/key.pem": 0o640}
AUTHORITY, TALKER = ("", "private/ca.key.pem"), ("/talker", "src/talker/issuance.xml")


def adopted(keymint, folder: Path, modes: Mapping[str, int]) -> Path:
    """Return the workspace of a keystore without links, in which some keys have other modes."""
    keystore = made(folder / "ks")
    for path in keystore.rglob("*"):
        if path.is_symlink():
            content = path.read_bytes()
            path.unlink()
            path.write_bytes(content)
            path.chmod(0o600 if "key" in path.name else 0o644)
    for path, mode in modes.items():
        (keystore / path).chmod(mode)
    assert keymint("adopt", "ks", "--apply", "-w", "ws").code == 0
    return folder / "ws"


def exposed(keymint, ws: Path, verb: str = "check") -> list[tuple[str, str]]:
    """Return the subjects of exposed keys, each with the file that remembers it."""
    outcome = keymint(verb, "--json", cwd=ws)
    found = [each for each in outcome.document["diagnostics"] if each["code"] == "key-was-exposed"]
    assert all(each["severity"] == "warning" for each in found)
    assert outcome.code == 3 or not found or verb != "check"
    return [(each["subject"], each["file"]) for each in found]


def advice(keymint, ws: Path) -> str:
    """Return the first command that the finding on an exposed key names."""
    outcome = keymint("check", "--json", cwd=ws)
    (help_,) = [each["help"] for each in outcome.document["diagnostics"] if each["code"] == "key-was-exposed"]
    return help_.split("'")[1]


def test_keys_that_nobody_else_could_read(keymint, tmp_path: Path) -> None:
    assert exposed(keymint, adopted(keymint, tmp_path, {})) == []


def test_they_are_remembered_without_the_record_and_in_a_copy(keymint, tmp_path: Path) -> None:
    ws = adopted(keymint, tmp_path, MODES)
    assert exposed(keymint, ws) == [AUTHORITY, TALKER]
    assert exposed(keymint, ws, "status") == [AUTHORITY, TALKER]
    shutil.rmtree(ws / ".keymint")
    assert exposed(keymint, ws) == [AUTHORITY, TALKER]
    assert keymint("install", "-w", "ws").code == 0
    assert exposed(keymint, ws) == [AUTHORITY, TALKER]


def test_it_ends_with_the_certificates_of_the_key_and_not_with_new_ones(keymint, tmp_path: Path) -> None:
    """The advice is followed: whoever copied the key has a certificate for it, and may have it for years."""
    ws = adopted(keymint, tmp_path, {"enclaves/talker/key.pem": 0o640})
    for step in ("authority", "identifiers"):
        assert keymint("harden", step, "--apply", "--flag-day", cwd=ws).code == 0
    assert keymint("renew", "talker", cwd=ws).code == 0
    assert exposed(keymint, ws) == [TALKER]
    for left in ([TALKER], []):
        words = advice(keymint, ws).split()
        assert keymint(*words[1:], cwd=ws).code == 0, words
        assert exposed(keymint, ws) == left


def test_it_ends_when_the_certificates_end(keymint, tmp_path: Path) -> None:
    ws = adopted(keymint, tmp_path, {"enclaves/talker/key.pem": 0o640})
    assert keymint("renew", "--rekey", "talker", cwd=ws).code == 0
    assert "key-was-exposed" in keymint("check", "--json", cwd=ws).codes()
    later = {"SOURCE_DATE_EPOCH": str(NOW + 4000 * 86_400)}
    assert "key-was-exposed" not in keymint("check", "--json", cwd=ws, env=later).codes()


@pytest.mark.parametrize("words", [("authority", "renew", "ca", "--flag-day"), ("authority", "export", "ca")])
def test_what_keeps_the_key_of_an_authority(keymint, tmp_path: Path, words: tuple[str, ...]) -> None:
    ws = adopted(keymint, tmp_path, {"private/ca.key.pem": 0o644})
    assert keymint(*words, cwd=ws).code == 0
    assert exposed(keymint, ws) == [AUTHORITY]


def test_a_new_key_of_an_authority_ends_it_once_no_enclave_trusts_the_old_one(keymint, tmp_path: Path) -> None:
    ws = adopted(keymint, tmp_path, {"private/ca.key.pem": 0o644})
    assert keymint("authority", "replace", "ca", cwd=ws).code == 0
    assert exposed(keymint, ws) == [AUTHORITY]
    assert keymint("authority", "replace", "ca", "--phase", "end", cwd=ws).code == 0
    assert exposed(keymint, ws) == []


def test_a_replacement_that_is_given_up_does_not_end_it(keymint, tmp_path: Path) -> None:
    ws = adopted(keymint, tmp_path, {"private/ca.key.pem": 0o644})
    assert keymint("authority", "replace", "ca", cwd=ws).code == 0
    assert keymint("authority", "replace", "ca", "--cancel", cwd=ws).code == 0
    assert exposed(keymint, ws) == [AUTHORITY]


def test_a_damaged_file_hides_no_other_key(keymint, tmp_path: Path) -> None:
    ws = adopted(keymint, tmp_path, MODES)
    (ws / "src/robot1/listener/issuance.xml").write_text("<issuance/>")
    assert exposed(keymint, ws) == [AUTHORITY, TALKER]
    assert keymint("status", "--json", cwd=ws).codes().count("key-was-exposed") == 2
