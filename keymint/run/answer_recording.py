# SPDX-License-Identifier: Apache-2.0
"""Record what a command will print if it is given again, so that it need not be carried out; see ADR 0002."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from datetime import datetime

from keymint.authority.authorities import STAGE as AUTHORITIES
from keymint.life.revocation_lists_in_force import loaded_lists
from keymint.output.console import Console
from keymint.output.report import Report
from keymint.store.changes import Action, File, Plan, Step
from keymint.store.store import Store
from keymint.view.folder_status import Sight
from keymint.view.recorded_answers import Answer, Call, is_recordable, name_of, record
from keymint.workspace.package_build_types import BUILD
from keymint.workspace.policy_loading import recorded_files
from keymint.workspace.session import Inputs, Session


def remember(
    call: Call, inputs: Inputs, plan: Plan, report: Report, sight: Sight | None, store: Store, console: Console
) -> None:
    """Record the answer to a command, unless something is in doubt.

    Args:
        call: the command.
        inputs: the workspace before it.
        plan: what it did.
        report: what it reports.
        sight: the files after it; None if another program may have changed some.
        store: the writer.
        console: where the report is shown.
    """
    expected = next_report(plan, report)
    if expected is None or sight is None or not is_recordable(call, str(inputs.workspace.root)):
        return
    session = _session_after(inputs, plan)
    seen = recorded_files(session)
    if seen is None:
        return
    answer = Answer(*console.rendered(expected), int(expected.exit_code))
    content = record(call, str(inputs.workspace.root), sight, seen, _dates(session), answer)
    if content is not None:
        store.write(inputs.workspace.state, {name_of(call): File(content)})


def _session_after(inputs: Inputs, plan: Plan) -> Session:
    """Return profile, authorities and record as they are after a plan; the enclaves of a fleet would take memory."""
    workspace = inputs.workspace
    changed = [item for space in (workspace.profile, workspace.public) for item in plan.overlay(f"{space}/")]
    return replace(inputs, tree=inputs.tree.overlaid(changed), state=plan.state).session()


def _dates(session: Session) -> Iterator[datetime]:
    """Yield the dates of authorities and revocation lists."""
    for authority in session.profile.authorities:
        yield authority.certificate.validity.not_before
        yield authority.certificate.validity.not_after
    for found in loaded_lists(session).values():
        yield found.next_update


def next_report(plan: Plan, report: Report) -> Report | None:
    """Return what a command reports if it is given again, or None if that is not known.

    What has nothing to do does the same again. After one that did something without any diagnostic, everything is
    unchanged, and no workspace is new.
    """
    if not plan.writes():
        return report
    if report.diagnostics or any(_is_unclear(step) for step in plan.steps):
        return None
    # What has no package is only reported if it is written.
    return replace(report, steps=[_again(step) for step in plan.steps if step.package])


def _is_unclear(step: Step) -> bool:
    """Tell whether it is not known how a step is reported next time."""
    return step.action in {Action.REMOVED, Action.KEPT} or (step.stage == BUILD and not step.package)


def _again(step: Step) -> Step:
    return Step(step.stage, step.package, Action.UNCHANGED, detail=step.detail if step.stage == AUTHORITIES else "")
