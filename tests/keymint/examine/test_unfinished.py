# SPDX-License-Identifier: Apache-2.0
"""A run that was killed while its work became visible is a finding, until a later one finishes it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from keymint.store.journal import MARK, Journal, intent_of
from keymint.store.staged import Exchange


def test_a_run_that_may_be_visible_in_part_is_a_finding(keymint: Callable, provisioned: Path) -> None:
    records = provisioned / ".keymint"
    exchange = Exchange(0, str(provisioned / "public"), "gone", None, file=True)
    (records / MARK).write_bytes(Journal("keymint renew", exchanges=(exchange,)).dump(records))
    for verb in ("check", "prove"):
        outcome = keymint(verb, "--json", cwd=provisioned)
        assert (outcome.code, "run-unfinished" in outcome.codes()) == (3, True)
    assert keymint("install", cwd=provisioned).code == 0
    assert keymint("check", cwd=provisioned).code == 0


def test_a_run_that_changed_nothing_yet_is_none(keymint: Callable, provisioned: Path) -> None:
    records = provisioned / ".keymint"
    (records / MARK).write_bytes(Journal("keymint renew").dump(records))
    assert keymint("check", cwd=provisioned).code == 0


def test_names_are_no_paths(tmp_path: Path) -> None:
    """The root enclave is no folder whose files are read."""
    (tmp_path / "talker").mkdir()
    before = intent_of(["renew", "/", "talker"], tmp_path)
    (tmp_path / "talker/file").touch()
    assert intent_of(["renew", "/", "talker"], tmp_path) == before
    (tmp_path / "policy.xml").write_text("1")
    first = intent_of(["provision", "policy.xml"], tmp_path)
    (tmp_path / "policy.xml").write_text("2")
    assert intent_of(["provision", "policy.xml"], tmp_path) != first
