# SPDX-License-Identifier: Apache-2.0
"""The files of a replacement under way: what a killed run leaves, and what a person may have done to them."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from keymint.api import Phase
from keymint.authority import rollover
from tests.keymint.commands.life.test_authority import IDENTITY
from tests.keymint.stages.keystores import AUTHORITY_KEYS, CERTIFICATES, content, public_key
from tests.keymint.stages.sessions import session_of

BUNDLES = ("--vendor", "fastdds")
NEXT, FORMER = "private/identity_ca.next.key.pem", "private/identity_ca.former.key.pem"


@pytest.fixture
def begun(keymint, ws: Path) -> Callable:
    """Return a function that begins, and returns the workspace."""

    def begin(*words: str) -> Path:
        outcome = keymint("authority", "replace", IDENTITY, *words, cwd=ws)
        assert outcome.code == 0, outcome.err
        return ws

    return begin


@pytest.mark.parametrize("words", [(), BUNDLES], ids=["second keystore", "bundles"])
def test_a_run_that_was_killed_between_key_and_profile_is_recognised_and_completed(
    keymint, begun: Callable, words: tuple[str, ...]
) -> None:
    ws = begun(*words)
    key = (ws / NEXT).read_bytes()
    if words:
        (ws / AUTHORITY_KEYS[0]).rename(ws / FORMER)
    (ws / NEXT).rename(ws / AUTHORITY_KEYS[0])
    assert rollover.is_interrupted(session_of(ws), IDENTITY)
    before = content(ws)
    for verb in ("install", "authority renew identity_ca"):
        outcome = keymint(*verb.split(), cwd=ws)
        assert (outcome.code, "interrupted" in outcome.err or "being replaced" in outcome.err) == (1, True)
    refused = keymint("authority", "replace", IDENTITY, "--cancel", "--json", cwd=ws)
    assert (refused.code, refused.codes()) == (1, ["rollover-too-late"])
    assert content(ws) == before
    outcome = keymint("authority", "replace", IDENTITY, cwd=ws)
    assert outcome.code == 0, outcome.err
    assert rollover.phase_of(session_of(ws), IDENTITY) is (Phase.REISSUE if words else None)
    assert (ws / AUTHORITY_KEYS[0]).read_bytes() == key
    assert public_key(ws / CERTIFICATES[0]) == public_key(ws / AUTHORITY_KEYS[0])
    assert keymint("check", cwd=ws).code == 0


def test_a_run_that_was_killed_between_two_keys_keeps_the_former_one(keymint, begun: Callable) -> None:
    ws = begun(*BUNDLES)
    former, key = (ws / AUTHORITY_KEYS[0]).read_bytes(), (ws / NEXT).read_bytes()
    (exchanged, *_) = rollover.plan_switch(session_of(ws), IDENTITY).steps
    written = exchanged.changes[0].files
    assert {name: file.content for name, file in written.items()} == {
        Path(FORMER).name: former,
        "identity_ca.key.pem": key,
    }
    assert next(iter(written)) == Path(FORMER).name
    shutil.copy(ws / AUTHORITY_KEYS[0], ws / FORMER)
    shutil.copy(ws / NEXT, ws / AUTHORITY_KEYS[0])
    begun()
    assert [(ws / name).read_bytes() for name in (AUTHORITY_KEYS[0], FORMER)] == [key, former]
    assert not (ws / NEXT).exists()
    assert keymint("check", cwd=ws).code == 0


def test_no_copy_of_the_key_in_force_is_left_if_it_is_cancelled(keymint, begun: Callable) -> None:
    ws = begun(*BUNDLES)
    key = (ws / AUTHORITY_KEYS[0]).read_bytes()
    shutil.copy(ws / AUTHORITY_KEYS[0], ws / FORMER)  # as a run that was killed before it exchanged the keys
    assert keymint("authority", "replace", IDENTITY, "--cancel", cwd=ws).code == 0
    assert (ws / AUTHORITY_KEYS[0]).read_bytes() == key
    assert not (ws / NEXT).exists()
    assert not (ws / FORMER).exists()
    begun(*BUNDLES)
    (ws / AUTHORITY_KEYS[0]).rename(ws / FORMER)  # as one that was killed where the next key is elsewhere
    assert keymint("authority", "replace", IDENTITY, "--cancel", cwd=ws).code == 0
    assert (ws / FORMER).read_bytes() == key


def test_a_next_key_that_a_killed_run_left_is_used(keymint, begun: Callable) -> None:
    ws = begun(*BUNDLES)
    key = (ws / NEXT).read_bytes()
    assert keymint("authority", "replace", IDENTITY, "--cancel", cwd=ws).code == 0
    (ws / NEXT).write_bytes(key)
    begun(*BUNDLES)
    assert (ws / NEXT).read_bytes() == key


def test_another_next_key_is_not_taken(keymint, begun: Callable) -> None:
    ws = begun(*BUNDLES)
    (ws / NEXT).write_bytes((ws / AUTHORITY_KEYS[1]).read_bytes())
    before = content(ws)
    outcome = keymint("authority", "replace", IDENTITY, "--phase", "reissue", "--json", cwd=ws)
    assert (outcome.code, outcome.codes()) == (1, ["authority-key-mismatch"])
    assert content(ws) == before


def test_without_the_former_key_the_former_authority_revokes_nothing(keymint, begun: Callable) -> None:
    ws = begun(*BUNDLES)
    begun("--phase", "reissue")
    (ws / FORMER).unlink()
    before = content(ws)
    outcome = keymint("revoke", "talker", "--reason", "superseded", "--json", cwd=ws)
    assert (outcome.code, outcome.codes()) == (1, ["authority-key-missing"])
    assert "identity_ca.former" in outcome.document["diagnostics"][0]["message"]
    assert content(ws) == before


def test_an_authority_with_the_name_of_a_file_is_refused(keymint, ws: Path) -> None:
    path = ws / "profile/authorities.xml"
    extra = '<authority name="identity_ca.next"><cert><issuer_name/></cert></authority></authorities>'
    path.write_text(path.read_text().replace("</authorities>", extra))
    for verb in ("build", "install"):
        assert keymint(verb, cwd=ws).code == 0
    outcome = keymint("authority", "replace", IDENTITY, "--json", cwd=ws)
    assert (outcome.code, outcome.codes()) == (1, ["authority-name-taken"])
