# SPDX-License-Identifier: Apache-2.0
"""A verb that takes something away stops unless the user agrees, with ``--yes`` or on a terminal."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.conftest import Outcome
from tests.keymint.run.terminal import on_terminal

LOSE = """
import sys
from comarmor.errors import Diagnostic
from keymint import cli
from keymint.command_line.verb import verb

REASON = Diagnostic.warning("rights-lost", "/talker loses its rights")

@verb(workspace=False, dry_run=True, yes=True)
def transports(run):
    told = run.confirm([REASON], lambda: run.console.line("in detail"))
    assert run.confirm([REASON]) == told, "asked twice for one thing"
    assert run.confirm([]) == ()
    run.console.line("done")
    return run.report({}, told)

cli.cli.get_command = lambda *_: transports
sys.exit(cli.main(["transports", *sys.argv[1:]]))
"""


def lose(folder: Path, *options: str, answer: str = "y\n", stdin: bool = True) -> Outcome:
    return on_terminal(options, folder, answer, program=("-c", LOSE), stdin=stdin)


@pytest.mark.parametrize("answer", ["y\n", "yes\n", " Y \n"])
def test_yes_on_a_terminal_goes_on(tmp_path: Path, answer: str) -> None:
    outcome = lose(tmp_path, answer=answer)
    assert (outcome.code, outcome.out) == (0, "in detail\ndone\n")
    assert outcome.err.count("warning: /talker loses its rights [rights-lost]\n") == 1
    assert outcome.err.count("Go on? [y/N] ") == 1


@pytest.mark.parametrize("answer", ["n\n", "\n", "yes!\n", "\x04"])
def test_any_other_answer_stops(tmp_path: Path, answer: str) -> None:
    outcome = lose(tmp_path, answer=answer)
    assert (outcome.code, outcome.out) == (3, "in detail\n")
    assert "warning: /talker loses its rights [rights-lost]\n" in outcome.err
    assert outcome.err.endswith("error: nothing was written, as you answered [not-confirmed]\n")


@pytest.mark.parametrize(("options", "stdin"), [(("-q",), True), (("--json",), True), ((), False)])
def test_nothing_is_asked_without_a_terminal_or_quietly(tmp_path: Path, options: tuple[str, ...], stdin: bool) -> None:
    outcome = lose(tmp_path, *options, stdin=stdin)
    assert outcome.code == 3
    assert "Go on" not in outcome.err
    assert "done" not in outcome.out
    if "--json" in options:
        found = [(each["code"], each["severity"]) for each in json.loads(outcome.out)["diagnostics"]]
        assert found == [("rights-lost", "error"), ("not-confirmed", "error")]
    else:
        assert "error: /talker loses its rights [rights-lost]\n" in outcome.err
        assert outcome.err.endswith("error: nothing was written (if this is wanted, add --yes) [not-confirmed]\n")


@pytest.mark.parametrize("option", ["--yes", "--dry-run"])
def test_who_agreed_before_and_a_dry_run_are_only_told(tmp_path: Path, option: str) -> None:
    outcome = lose(tmp_path, option)
    assert (outcome.code, outcome.out) == (0, "done\n")
    asks = "warning: the run itself asks first (if this is wanted, add --yes) [not-confirmed]\n"
    told = "warning: /talker loses its rights [rights-lost]\n"
    assert outcome.err.endswith(told + asks if option == "--dry-run" else told)
    assert "Go on" not in outcome.err
