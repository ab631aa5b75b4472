# SPDX-License-Identifier: Apache-2.0
"""Wherever a verb takes names, it takes patterns, files of names, and states; what finds nothing is an error."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.conftest import NOW, snapshot

LATE = {"SOURCE_DATE_EPOCH": str(NOW + 300 * 86400)}
VERBS = (
    ("build",), ("install",), ("check",), ("prove",), ("verify",), ("renew",),
    ("issued",), ("status",), ("bundle",), ("create",), ("revoke", "--reason", "superseded"), ("remove",),
)  # fmt: skip


@pytest.mark.parametrize("verb", VERBS, ids=[each[0] for each in VERBS])
@pytest.mark.parametrize("wrong", ["/nobody*", "robot1/listner", "--from"])
def test_every_verb_refuses_what_finds_nothing(
    keymint: Callable, provisioned: Path, verb: tuple[str, ...], wrong: str
) -> None:
    (provisioned / "names.txt").write_text("talker\n# a comment\n/nobody*\n")
    words = (wrong, "names.txt") if wrong == "--from" else (wrong,)
    before = snapshot(provisioned)
    refused = keymint(*verb, *words, "--json", cwd=provisioned)
    assert refused.code == 1, refused.out
    (said,) = refused.document["diagnostics"]
    assert said["code"] in {"package-unknown", "subject-unknown"}
    if wrong == "robot1/listner":
        assert "robot1/listener'?" in said["help"]
    if wrong == "--from":
        assert (said["file"], said["line"]) == ("names.txt", 3)
    assert snapshot(provisioned) == before


@pytest.mark.parametrize("words", [("/robot1/*",), ("robot?/*",), ("--from", "names.txt"), ("*/listener",)])
def test_a_pattern_and_a_file_stand_for_packages(keymint: Callable, provisioned: Path, words: tuple[str, ...]) -> None:
    (provisioned / "names.txt").write_text("\ufeff# fleet\n/robot1/l*  # one\n\nrobot1/listener\n")
    assert keymint("check", *words, "--json", cwd=provisioned).document["result"]["checked"] == ["/robot1/listener"]


def test_all_that_is_wrong_is_said_at_once(keymint: Callable, provisioned: Path) -> None:
    refused = keymint("check", "talkr", "talker", "/x*", "a-b", "--json", cwd=provisioned)
    assert refused.codes() == ["package-unknown", "package-unknown", "name-illegal"]


def test_a_file_that_names_nothing_does_not_stand_for_all(keymint: Callable, provisioned: Path) -> None:
    (provisioned / "names.txt").write_text("# nobody\n")
    assert keymint("build", "--from", "names.txt", "--json", cwd=provisioned).codes() == ["names-none"]


def test_states(keymint: Callable, provisioned: Path) -> None:
    def checked(state: str, **more: object) -> list[str]:
        return keymint("check", "--no-prove", "--state", state, "--json", cwd=provisioned, **more).document["result"][
            "checked"
        ]

    assert checked("due") == checked("stale") == checked("revoked") == []
    assert "no package is due" in keymint("check", "--state", "due", cwd=provisioned).out
    assert checked("due", env=LATE) == ["/robot1/listener", "/talker"]
    assert keymint("revoke", "talker", "--reason", "key-compromise", cwd=provisioned).code == 0
    assert checked("revoked") == ["/talker"]
    assert keymint("renew", "--rekey", "--state", "revoked", "--yes", cwd=provisioned).code == 0
    assert checked("revoked") == []
    identities = provisioned / "src/talker/identities.xml"
    identities.write_text(identities.read_text().replace("<identity/>", "<identity><cert/></identity>"))
    assert checked("stale") == ["/talker"]
    assert keymint("status", "--state", "stale", "/r*", cwd=provisioned).out.startswith("no package is stale")


@pytest.mark.parametrize(
    "words",
    [("revoke", "--reason", "retired"), ("build", "--rekey"), ("renew", "--rekey"), ("provision", "../policy.xml")],
    ids=lambda words: words[0],
)
def test_what_a_pattern_takes_away_needs_a_yes(keymint: Callable, provisioned: Path, words: tuple[str, ...]) -> None:
    before = snapshot(provisioned)
    pattern = "--rekey=/*" if words[0] == "provision" else "/*"
    stopped = keymint(*words, pattern, cwd=provisioned)
    assert stopped.code == 3
    assert "/robot1/listener, /talker" in stopped.err
    assert snapshot(provisioned) == before
    assert keymint(*words, pattern, "--yes", cwd=provisioned).code == 0


@pytest.mark.parametrize("words", [("remove",), ("revoke", "--reason", "retired"), ("build", "--rekey")])
def test_a_pattern_that_finds_nothing_names_nobody_else(keymint, provisioned: Path, words: tuple[str, ...]) -> None:
    refused = keymint(*words, "/tal?err", cwd=provisioned)
    assert refused.code != 0
    assert "matches '/tal?err'" in refused.err
    assert "talker" not in refused.err
