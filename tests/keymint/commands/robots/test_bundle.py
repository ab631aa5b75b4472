# SPDX-License-Identifier: Apache-2.0
"""``keymint bundle``."""

from __future__ import annotations

import re
import shutil
import stat
from pathlib import Path
from typing import Any

import pytest

from comarmor.errors import Origin
from keymint.robots import bundle
from keymint.robots.bundle import Bundle
from tests.conftest import NOW, snapshot


def ran(keymint, *arguments: object, env: dict[str, str] | None = None) -> dict[str, Any]:
    outcome = keymint(*arguments, "--json", env=env)
    assert outcome.code == 0, outcome.out
    return outcome.document["result"]


def read(path: Path) -> Bundle:
    return bundle.read(path.read_bytes(), Origin(path.name))


def test_a_key_that_was_made_here_is_in_it(keymint, ws: Path, tmp_path: Path) -> None:
    outcome = keymint("bundle", "/talker", "-w", "ws")
    assert (outcome.code, outcome.err) == (0, "")
    assert "it has the private key of /talker" in outcome.out
    file = tmp_path / "talker.bundle"
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    assert dict(read(file).files) == {
        path.name: path.read_bytes() for path in (ws / "install/enclaves/talker").iterdir()
    }


def test_it_says_when_all_of_it_is_in_force(keymint, ws: Path, tmp_path: Path) -> None:
    ran(keymint, "bundle", "talker", "-w", "ws")
    found = read(tmp_path / "talker.bundle")
    assert found.manifest.not_before == found.certificate.not_valid_before_utc
    assert found.manifest.not_after == found.certificate.not_valid_after_utc


def test_patterns_match_names(keymint, ws: Path, tmp_path: Path) -> None:
    assert [each["enclave"] for each in ran(keymint, "bundle", "/robot?/*", "-w", "ws")["bundles"]] == [
        "/robot1/listener"
    ]
    assert {each["enclave"] for each in ran(keymint, "bundle", "*", "-w", "ws")["bundles"]} == {
        "/robot1/listener",
        "/talker",
    }
    assert (tmp_path / "robot1.listener.bundle").exists()


def test_a_pattern_passes_over_what_was_revoked(keymint, ws: Path) -> None:
    assert keymint("revoke", "talker", "--reason", "key-compromise", "-w", "ws").code == 0
    assert [each["enclave"] for each in ran(keymint, "bundle", "/*", "-w", "ws")["bundles"]] == ["/robot1/listener"]
    refused = keymint("bundle", "/tal*", "-w", "ws")
    assert (refused.code, "no package matches '/tal*'" in refused.err) == (1, True)


@pytest.mark.parametrize("listed", [False, True])
def test_what_a_pattern_passes_over_is_told_with_its_old_file(keymint, ws: Path, tmp_path: Path, listed: bool) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "names").write_text("/*\n")
    words = ("bundle", *(("--from", "names") if listed else ("/*",)), "-w", "ws", "--json")
    ran(keymint, *words[:-1], "-o", "out")
    assert keymint("revoke", "talker", "--reason", "retired", "-w", "ws").code == 0
    outcome = keymint(*words, "-o", "out")
    [found] = outcome.document["diagnostics"]
    assert (outcome.code, found["code"], found["severity"]) == (0, "identity-revoked", "warning")
    assert (found["subject"], found["file"]) == ("/talker", "out/talker.bundle")
    assert "revoked (retired), so this one is out of date" in found["message"]
    (tmp_path / "out/talker.bundle").unlink()
    for output in ("out", "single"):
        [found] = keymint(*words, "-o", output).document["diagnostics"]
        assert (found["file"], "out of date" in found["message"]) == (None, False)


def test_a_file_or_a_folder(keymint, ws: Path, tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    assert ran(keymint, "bundle", "talker", "-w", "ws", "-o", "x")["bundles"][0]["file"] == "x"
    assert ran(keymint, "bundle", "talker", "-w", "ws", "-o", "out")["bundles"][0]["file"] == "out/talker.bundle"
    refused = keymint("bundle", "*", "-w", "ws", "-o", "x", "--json")
    assert (refused.code, refused.codes()) == (2, ["usage"])


def test_every_bundle_has_a_number_of_its_own(keymint, ws: Path) -> None:
    numbers = [ran(keymint, "bundle", "talker", "-w", "ws")["bundles"][0]["issue"] for _ in range(3)]
    assert numbers == [NOW, NOW + 1, NOW + 2]
    earlier = ran(keymint, "bundle", "talker", "-w", "ws", env={"SOURCE_DATE_EPOCH": str(NOW - 3600)})
    assert earlier["bundles"][0]["issue"] == NOW + 3


def test_a_dry_run_changes_nothing(keymint, ws: Path, tmp_path: Path) -> None:
    before = snapshot(tmp_path)
    assert ran(keymint, "bundle", "talker", "-w", "ws", "--dry-run")["bundles"]
    assert snapshot(tmp_path) == before


def test_nothing_but_the_register_changes(keymint, ws: Path) -> None:
    ran(keymint, "bundle", "talker", "-w", "ws")
    before = snapshot(ws)
    ran(keymint, "bundle", "talker", "-w", "ws")
    after = snapshot(ws)
    changed = {path for path in after if after[path][2] != before.get(path, (0, 0, b""))[2]}
    assert changed <= {"private/register.sqlite3", "private/runs.jsonl", ".keymint/state.json"}
    assert "private/register.sqlite3" in changed


@pytest.mark.parametrize("name", ["talke", "/nobody", "/x*"])
def test_a_name_that_is_none(keymint, ws: Path, name: str) -> None:
    refused = keymint("bundle", name, "-w", "ws", "--json")
    assert (refused.code, refused.codes()) == (1, ["package-unknown"])


def test_what_is_not_installed_as_it_should_be_does_not_leave(keymint, ws: Path, tmp_path: Path) -> None:
    permissions = ws / "install/enclaves/talker/permissions.p7s"
    content = permissions.read_bytes()
    permissions.write_bytes(b"altered")
    assert keymint("bundle", "talker", "-w", "ws", "--json").codes() == ["not-installed"]
    permissions.write_bytes(content)
    source = ws / "src/talker/permissions.xml"
    source.write_text(source.read_text().replace("/chatter", "/chat"))
    # The documents that are installed are those that are built: the owner decides when to build again.
    assert keymint("bundle", "talker", "-w", "ws", "--json").codes() == ["not-installed"]
    assert not (tmp_path / "talker.bundle").exists()


@pytest.mark.parametrize("is_there", [True, False])
def test_the_commands_that_the_refusal_names_lead_to_a_bundle(keymint, ws: Path, is_there: bool) -> None:
    dates = ws / "profile/package.defaults/permissions.xml"
    dates.write_text(re.sub("<not_after>[^<]*<", "<not_after>2027-12-01T00:00:00<", dates.read_text()))
    if not is_there:
        shutil.rmtree(ws / "install/enclaves/talker")
        assert keymint("build", "talker", "-w", "ws").code == 0
    (refused,) = keymint("bundle", "talker", "-w", "ws", "--json").document["diagnostics"]
    assert (refused["code"], "'keymint build" in refused["help"]) == ("not-installed", is_there)
    for command in re.findall("'keymint ([^']*)'", refused["help"]):
        assert keymint(*command.split()).code == 0
    assert keymint("bundle", "talker", "-w", "ws").code == 0


def test_an_enclave_without_the_list_that_changed(keymint, policy: Path, tmp_path: Path) -> None:
    """The router of Zenoh reads no revocation list: a new one changes what it is made from, and none of its files."""
    assert keymint("provision", policy, "-w", "ws", "--transport", "dds", "--transport", "zenoh").code == 0
    assert keymint("revoke", "talker", "--reason", "superseded", "-w", "ws").code == 0
    found = {each["enclave"]: each["revocations"] for each in ran(keymint, "bundle", "*", "-w", "ws")["bundles"]}
    assert found == {"/talker": 1, "/robot1/listener": 1, "/zenoh_router": 0}
    assert "session.json5" in read(tmp_path / "talker.bundle").files


def test_a_revoked_enclave_has_no_bundle(keymint, ws: Path) -> None:
    assert keymint("revoke", "talker", "--reason", "key-compromise", "-w", "ws").code == 0
    assert keymint("bundle", "talker", "-w", "ws", "--json").codes() == ["identity-revoked"]


def test_an_authority_whose_key_is_elsewhere_signs_no_bundle(keymint, ws: Path, tmp_path: Path) -> None:
    (ws / "private/identity_ca.key.pem").rename(tmp_path / "elsewhere.pem")
    assert keymint("bundle", "talker", "-w", "ws", "--json").codes() == ["authority-key-missing"]


def test_a_folder_that_cannot_be_written(keymint, ws: Path) -> None:
    refused = keymint("bundle", "talker", "-w", "ws", "-o", "/proc/x", "--json")
    assert refused.code == 1
    assert refused.codes() == ["write-failed"]
