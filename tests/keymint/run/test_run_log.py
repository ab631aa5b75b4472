# SPDX-License-Identifier: Apache-2.0
"""The log of runs: one line for each run that wrote, none for others, bounded, without secrets, and atomic."""

from __future__ import annotations

import json
from datetime import datetime
from pathlib import Path

import pytest

from keymint.run.run_log import MOST_BYTES, MOST_RUNS
from tests.conftest import NOW, snapshot

LOG = "runs.jsonl"


def lines_of(workspace: Path) -> list[dict]:
    return [json.loads(line) for line in (workspace / "private" / LOG).read_text().splitlines()]


def logged(keymint, workspace: Path) -> list[dict]:
    outcome = keymint("status", "--log", "--json", "-w", workspace)
    assert outcome.code == 0
    return outcome.document["result"]["runs"]


def test_each_run_that_writes_is_told(keymint, just_provisioned: Path, policy: Path) -> None:
    ((first,), path) = logged(keymint, just_provisioned), just_provisioned / "private" / LOG
    assert first["verb"] == "provision"
    assert first["command"] == f"keymint provision {policy} -w ws"
    assert first["user"]
    assert first["host"]
    assert first["version"]
    assert datetime.fromisoformat(first["at"]).timestamp() == int(NOW)
    assert first["workspace"] == str(just_provisioned)
    assert {"talker", "robot1/listener"} <= {*first["names"]}
    assert first["steps"]["created"] > 0
    assert path.stat().st_mode & 0o777 == 0o600
    before = snapshot(just_provisioned)["private/" + LOG]
    keymint("provision", policy, "-w", "ws")
    keymint("provision", policy, "-w", "ws", "--force")
    keymint("check", "-w", "ws")
    keymint("renew", "-w", "ws", "--dry-run")
    keymint("install", "-w", "ws")
    assert snapshot(just_provisioned)["private/" + LOG] == before
    assert keymint("revoke", "talker", "--reason", "retired", "-w", "ws", "-q", "--yes").code == 0
    assert [run["verb"] for run in logged(keymint, just_provisioned)] == ["provision", "revoke"]
    assert logged(keymint, just_provisioned)[1]["command"].endswith(" --yes")
    shown = keymint("status", "--log", "-w", "ws").out
    assert shown.splitlines()[0].split() == ["WHEN", "WHO", "VERSION", "WHAT"]
    assert "revoke talker --reason retired" in " ".join(shown.split())


def test_a_refused_run_is_not_told(keymint, just_provisioned: Path) -> None:
    assert keymint("revoke", "nobody", "--reason", "retired", "-w", "ws").code == 1
    assert len(lines_of(just_provisioned)) == 1


def test_the_oldest_go(keymint, just_provisioned: Path) -> None:
    path = just_provisioned / "private" / LOG
    (one,) = path.read_text().splitlines()
    path.write_text(f"{one}\n" * (MOST_RUNS + 5))
    keymint("revoke", "talker", "--reason", "retired", "-w", "ws")
    runs = lines_of(just_provisioned)
    assert len(runs) <= MOST_RUNS
    assert path.stat().st_size <= MOST_BYTES
    assert runs[-1]["verb"] == "revoke"
    assert runs[-2]["verb"] == "provision"


def test_no_log_of_one_line_is_too_large(keymint, just_provisioned: Path) -> None:
    (just_provisioned / "private" / LOG).write_text("x" * MOST_BYTES)
    keymint("revoke", "talker", "--reason", "retired", "-w", "ws")
    assert [run["verb"] for run in lines_of(just_provisioned)] == ["revoke"]


@pytest.mark.parametrize(
    "line", ["", "{", "[]", "null", '{"at": 3}', '{"at": "2027-01-01T00:00:00+00:00"}', "[" * 100_000, "\0"]
)
def test_a_damaged_line_is_left_out(keymint, just_provisioned: Path, line: str) -> None:
    path = just_provisioned / "private" / LOG
    path.write_text(f"{line}\n{path.read_text()}")
    assert [run["verb"] for run in logged(keymint, just_provisioned)] == ["provision"]
    assert keymint("status", "--log", "-w", "ws").code == 0


def test_a_link_is_not_followed(keymint, just_provisioned: Path, tmp_path: Path) -> None:
    path, other = just_provisioned / "private" / LOG, tmp_path / "other"
    other.write_text("mine\n")
    path.unlink()
    path.symlink_to(other)
    assert keymint("revoke", "talker", "--reason", "retired", "-w", "ws").code == 0
    assert other.read_text() == "mine\n"
    assert keymint("status", "--log", "--json", "-w", "ws").codes() == ["symlink-refused"]


def test_no_secret_is_told(keymint, just_provisioned: Path) -> None:
    uri = "pkcs11:token=a;object=b?pin-value=1234&x=y"
    keymint("authority", "import", "identity_ca", "-w", "ws", uri)
    keymint("revoke", "talker", "--reason", "retired", "-w", "ws", "-w", f"{just_provisioned}/../ws/?password=p4ss")
    keymint("create", "pin-value=1234", "-w", "ws")
    assert "1234" not in (just_provisioned / "private" / LOG).read_text()
    assert "p4ss" not in (just_provisioned / "private" / LOG).read_text()


def test_without_private_files_nothing_is_told(keymint, created: Path) -> None:
    (created / "private").rename(created.parent / "safe")
    keymint("create", "another", "-w", "ws")
    assert not (created / "private").exists()


def test_none_yet(keymint, provisioned: Path) -> None:
    (provisioned / "private" / LOG).unlink(missing_ok=True)
    assert keymint("status", "--log", cwd=provisioned).out == "no run that wrote is on record\n"
