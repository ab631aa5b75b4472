# SPDX-License-Identifier: Apache-2.0
"""The answer to a command is recorded where it is certain, and what that needs is read only then."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from comarmor.errors import Diagnostic, Severity
from keymint.errors import ExitCode
from keymint.output.report import Report
from keymint.run.execution import next_report
from keymint.store.changes import Action, File, FolderChange, Plan, Step
from keymint.view.stamps import State
from keymint.workspace.session import Inputs, Session
from tests.conftest import Outcome


@pytest.fixture
def loaded(monkeypatch: pytest.MonkeyPatch) -> list[Session]:
    """Return the sessions whose profiles were loaded."""
    sessions: list[Session] = []
    load = Inputs.session

    def session(self: Inputs) -> Session:
        sessions.append(load(self))
        return sessions[-1]

    monkeypatch.setattr(Inputs, "session", session)
    return sessions


@pytest.mark.parametrize(("option", "times"), [((), 2), (("--rekey", "--yes", "*"), 1)], ids=["recorded", "each time"])
def test_the_profile_is_loaded_again_only_for_an_answer_that_is_recorded(
    keymint: Callable[..., Outcome], just_provisioned: Path, loaded: list[Session], option: tuple[str, ...], times: int
) -> None:
    assert keymint("build", *option, cwd=just_provisioned).code == 0
    assert len(loaded) == times


def test_a_copied_workspace_answers_about_its_own_policy(
    keymint: Callable[..., Outcome], tmp_path: Path, policy: Path
) -> None:
    """Its record names the policy of the workspace that it is a copy of, until a policy is read."""
    made = tmp_path / "made"
    made.mkdir()
    shutil.move(policy, made / "policy.xml")
    assert keymint("provision", "policy.xml", "-w", "ws", cwd=made).code == 0
    shutil.copytree(made, tmp_path / "copy")
    for name in ("one", "two"):
        more = f"<profile name='{name}'><attachment>/{name}</attachment></profile></profiles>"
        text = (made / "policy.xml").read_text().replace("</profiles>", more)
        (tmp_path / "copy/policy.xml").write_text(text)
        time.sleep(0.02)  # a status is trusted once the clock of the file system has moved on
        assert f": /{name} (" in keymint("build", "-w", "ws", cwd=tmp_path / "copy").err


def report(*steps: Step, diagnostics: tuple[Diagnostic, ...] = ()) -> tuple[Plan, Report]:
    return Plan(steps, State(), diagnostics), Report("build", None, steps, diagnostics, {}, ExitCode.DONE)


def test_what_did_something_has_nothing_to_do_next_time() -> None:
    change = FolderChange(Path("/w/build/a"), {"x": File(b"")})
    again = next_report(
        *report(Step("build", "a", Action.UPDATED, (change,), detail="why"), Step("build", "b", Action.UNCHANGED))
    )
    assert again is not None
    assert [(each.package, each.action, each.detail) for each in again.steps] == [
        ("a", Action.UNCHANGED, ""),
        ("b", Action.UNCHANGED, ""),
    ]


@pytest.mark.parametrize("action", [Action.REMOVED, Action.KEPT])
def test_it_is_not_known_what_follows_a_removal_or_a_package_that_was_kept(action: Action) -> None:
    change = FolderChange(Path("/w/build/a"), {"x": File(b"")})
    updated = Step("build", "a", Action.UPDATED, (change,))
    assert next_report(*report(updated, Step("build", "b", action))) is None


def test_a_diagnostic_is_certain_to_be_repeated_only_by_what_does_nothing() -> None:
    warning = Diagnostic("x", Severity.WARNING, "y")
    nothing, written = Step("build", "a", Action.UNCHANGED), FolderChange(Path("/w/build/a"), {"x": File(b"")})
    plan, same = report(nothing, diagnostics=(warning,))
    assert next_report(plan, same) is same
    once = Diagnostic("profile-copied", Severity.WARNING, "z")
    again = next_report(*report(Step("build", "a", Action.UPDATED, (written,)), diagnostics=(warning, once)))
    assert again is not None
    assert again.diagnostics == [warning]  # perhaps, so that it is not printed from the record
