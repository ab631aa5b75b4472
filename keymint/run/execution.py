# SPDX-License-Identifier: Apache-2.0
"""Carry out a plan: all its steps and their record in one group, which is visible as a whole or not at all.

Then what the command will print if it is given again is recorded, so that it need not be carried out; see ADR 0002.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from datetime import datetime

from keymint.authority.authorities import STAGE as AUTHORITIES
from keymint.errors import KeymintError
from keymint.life.revocation_lists_in_force import loaded_lists
from keymint.output.console import Console
from keymint.output.report import Report
from keymint.run.workers import Workers
from keymint.store.changes import Action, File, FolderChange, Plan, Step
from keymint.store.journal import Journal
from keymint.store.staged import Exchange
from keymint.store.store import Store, clock
from keymint.view.folder_status import Sight
from keymint.view.recorded_answers import Answer, Call, is_recordable, name_of, record
from keymint.view.stamps import State
from keymint.view.tree import Tree
from keymint.workspace.package_build_types import BUILD
from keymint.workspace.policy_loading import recorded_files
from keymint.workspace.session import Inputs, Session
from keymint.workspace.workspace import Workspace, missing_gitignores

RECORD = "state.json"


def open_store(workspace: Workspace) -> Store:
    """Return the store of a workspace: its root, its spaces and a second keystore; ``private`` is private."""
    roots = dict.fromkeys((workspace.root, *workspace.spaces(), workspace.next_install), False)
    return Store(roots | {workspace.private: True}, workspace.state)


def execute(
    plan: Plan,
    workspace: Workspace,
    store: Store,
    before: State,
    workers: Workers,
    on_step: Callable[[Step], None],
    intent: Journal,
) -> int:
    """Carry out a plan.

    Args:
        plan: the plan.
        workspace: the workspace.
        store: the writer.
        before: the previous record; written only if it changes.
        workers: the processes that hold a part of what is written.
        on_step: called for every step, after all of them.
        intent: what the run was asked for.

    Returns:
        The clock of the file system before anything became visible.

    Raises:
        KeymintError: the system refuses a write; no file is incomplete, and the next run finishes it, or drops it.
    """
    guards = missing_gitignores(workspace, plan)
    if not guards and not plan.writes() and plan.state == before:
        for step in plan.steps:
            on_step(step)
        return clock(workspace.state)
    changing = {step.package for step in plan.steps if step.package and step.writes()}
    store.begin(replace(intent, packages=tuple(sorted(changing))))
    for guard in guards:  # before the first secret is written
        store.write(guard.folder, guard.files, private=guard.private)
    staged = _staged(plan, FolderChange(workspace.state, {RECORD: File(plan.state.dump())}), store, workers)
    visible = clock(workspace.state)
    store.commit(staged)
    for step in plan.steps:
        on_step(step)
    return visible


def require_register(plan: Plan, workspace: Workspace, tree: Tree) -> None:
    """Require that the register which a plan replaces is the one that it was made from.

    A workspace that shares the private space writes it, too, and not every file system has locks.

    Args:
        plan: the plan.
        workspace: the workspace.
        tree: what the plan was made from.

    Raises:
        KeymintError: it is another one, so that serial numbers or revocations would be lost.
    """
    path = workspace.register
    if any(change.folder == path.parent and path.name in change.files for change in plan.first):
        present = Tree().digest(path)
        if present != tree.digest(path):
            raise KeymintError(
                "was changed by another run meanwhile, so nothing was written",
                where=workspace.origin(path),
                help="run the command again",
                code="register-changed",
            )


def _staged(plan: Plan, record: FolderChange, store: Store, workers: Workers) -> Sequence[Exchange]:
    """Stage a plan and its record. What other processes hold comes before what is removed."""
    if not any(change.held for change in plan.changes()):
        return store.stage((*plan.changes(), record))
    removals = Plan(tuple(step for step in plan.steps if step.action is Action.REMOVED), plan.state)
    others = replace(plan, steps=tuple(step for step in plan.steps if step.action is not Action.REMOVED))
    staged: list[Exchange] = []
    try:
        staged += store.stage(others.changes())
        staged += workers.stage(store)
        staged += store.stage((*removals.changes(), record))
    except BaseException:
        store.discard(staged)
        raise
    return staged


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
