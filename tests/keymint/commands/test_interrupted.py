# SPDX-License-Identifier: Apache-2.0
"""What becomes of a run that was interrupted: by the same command, and by another one."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from pathlib import Path

import pytest
from cryptography import x509

from keymint.client import Client
from keymint.store import group_commit
from keymint.store.staged import Exchange

REKEY = ("renew", "--rekey", "talker")
REVOKE = ("revoke", "talker", "--reason", "superseded")


def serial(ws: Path) -> int:
    return x509.load_pem_x509_certificate((ws / "install/enclaves/talker/cert.pem").read_bytes()).serial_number


def issued(keymint: Callable, ws: Path) -> list[int]:
    found = keymint("issued", "--json", cwd=ws).document["result"]["certificates"]
    return [int(each["serial"], 16) for each in found if each["subject"] == "/talker"]


@pytest.fixture
def stopped(monkeypatch: pytest.MonkeyPatch) -> Callable:
    """Return a function that calls another one, and stops it before its first name changes, or after one of them."""
    made = group_commit.make_visible

    def stop(call: Callable[[], object], after: str = "") -> None:
        seen: list[str] = []

        def stopping(folder: int, exchange: Exchange) -> str | None:
            if exchange.name != "running" and after in ("", *seen):
                raise KeyboardInterrupt
            seen.append(exchange.name)
            return made(folder, exchange)

        with monkeypatch.context() as patch:
            patch.setattr(group_commit, "make_visible", stopping)
            with contextlib.suppress(KeyboardInterrupt):
                assert call().code == 130

    return stop


@pytest.mark.parametrize("words", [REKEY, REVOKE], ids=["rekey", "revoke"])
def test_the_same_command_does_nothing_twice(
    keymint: Callable, provisioned: Path, stopped: Callable, words: tuple[str, ...]
) -> None:
    before = serial(provisioned)
    stopped(lambda: keymint(*words, cwd=provisioned), after="register.sqlite3")
    assert serial(provisioned) == before
    outcome = keymint(*words, "--json", cwd=provisioned)
    assert (outcome.code, outcome.codes()) == (0, ["run-interrupted"])
    assert issued(keymint, provisioned) == [before, serial(provisioned)] != [before, before]
    assert keymint(*words, cwd=provisioned).code == 0  # now it is asked for once more
    assert len(issued(keymint, provisioned)) == 3
    assert keymint("check", cwd=provisioned).code == 0


def test_another_command_finishes_what_is_visible_in_part_and_says_so(
    keymint: Callable, provisioned: Path, stopped: Callable
) -> None:
    before = serial(provisioned)
    stopped(lambda: keymint(*REKEY, cwd=provisioned), after="register.sqlite3")
    outcome = keymint("install", cwd=provisioned)
    assert outcome.code == 0
    (line,) = (line for line in outcome.err.splitlines() if "interrupted" in line)
    assert "'keymint renew --rekey talker' was interrupted; all that it was asked for is done now: /talker" in line
    assert issued(keymint, provisioned) == [before, serial(provisioned)]
    assert "interrupted" not in keymint("install", cwd=provisioned).err


def test_another_command_drops_what_is_not_visible_and_says_so(
    keymint: Callable, provisioned: Path, stopped: Callable
) -> None:
    before = serial(provisioned)
    stopped(lambda: keymint(*REVOKE, cwd=provisioned))
    outcome = keymint("install", cwd=provisioned)
    assert outcome.code == 0
    assert "'keymint revoke talker --reason superseded' was interrupted before anything changed, and is dropped" in (
        outcome.err
    )
    assert issued(keymint, provisioned) == [before] == [serial(provisioned)]  # nothing is revoked that nobody asks for
    assert not list(provisioned.rglob(".keymint-*"))


def test_calls_of_a_program_are_told_apart(provisioned: Path, keymint: Callable, stopped: Callable) -> None:
    client = Client(provisioned)
    stopped(lambda: client.renew("/talker", rekey=True), after="register.sqlite3")
    assert keymint("install", cwd=provisioned).code == 0
    found = issued(keymint, provisioned)
    stopped(lambda: client.renew("/talker", rekey=True), after="register.sqlite3")
    changed = client.renew("/robot1/listener", rekey=True)  # another call finishes it
    assert [each.subject for each in changed] == ["/robot1/listener", "/talker"]
    assert all(each.changed for each in changed)
    assert len(issued(keymint, provisioned)) == len(found) + 1
    client.renew("/talker", rekey=True)
    assert len(issued(keymint, provisioned)) == len(found) + 2


def test_a_command_that_fails_says_what_it_finished_as_well(
    keymint: Callable, provisioned: Path, stopped: Callable
) -> None:
    stopped(lambda: keymint(*REKEY, cwd=provisioned), after="register.sqlite3")
    refused = keymint("renew", "nobody", "--json", cwd=provisioned)
    assert (refused.code, refused.codes()) == (1, ["package-unknown", "run-interrupted"])
    assert keymint("check", cwd=provisioned).code == 0


def test_a_robot_says_what_it_dropped(keymint: Callable, tmp_path: Path, stopped: Callable) -> None:
    ask = ("request", "/talker", "--folder", "ks", "-o", "r.pem")
    stopped(lambda: keymint(*ask))
    outcome = keymint("request", "/listener", "--folder", "ks", "-o", "r.pem", "--json")
    assert (outcome.code, outcome.codes()) == (0, ["run-interrupted"])
    assert (
        "'keymint request /talker --folder ks -o r.pem' was interrupted"
        in outcome.document["diagnostics"][0]["message"]
    )
    assert not (tmp_path / "ks/.keymint/requests/talker").exists()
