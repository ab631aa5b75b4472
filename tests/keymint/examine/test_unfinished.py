# SPDX-License-Identifier: Apache-2.0
"""A run that was killed while its work became visible is a finding, until a later one finishes it."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

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


@pytest.mark.parametrize("has_records", [True, False])
def test_what_was_staged_and_never_seen_is_no_enclave_and_goes(
    keymint: Callable, provisioned: Path, has_records: bool
) -> None:
    """The run was killed when all was staged: its keys have a second name, its new folders look like enclaves."""
    records, enclaves = provisioned / ".keymint", provisioned / "install/enclaves"
    staged = enclaves / ".keymint-77-1.tmp"
    shutil.copytree(enclaves / "talker", staged)
    (staged / "key.pem").unlink()
    (staged / "key.pem").hardlink_to(enclaves / "talker/key.pem")
    if has_records:
        (records / MARK).write_bytes(Journal("keymint provision p.xml").dump(records))
    else:
        shutil.rmtree(records)
    outcome = keymint("check", "--json", cwd=provisioned)
    assert outcome.codes()[0] == "run-unfinished"
    assert outcome.code == 3
    assert {"key-linked", "file-unexpected", "counterexample"}.isdisjoint(outcome.codes())
    if has_records:
        assert "repeat 'keymint provision p.xml'" in outcome.document["diagnostics"][0]["help"]
    assert "run-unfinished" in keymint("prove", "--json", cwd=provisioned).codes()
    assert staged.exists()
    for verb in (("build", "-f"), ("install",)):
        assert keymint(*verb, cwd=provisioned).code == 0
        assert not staged.exists()
    assert keymint("check", cwd=provisioned).code == 0
