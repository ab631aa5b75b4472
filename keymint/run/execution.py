# SPDX-License-Identifier: Apache-2.0
"""Carry out a plan: all its steps and their record in one group, which is visible as a whole or not at all."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from keymint.errors import KeymintError
from keymint.run.workers import Workers
from keymint.store.changes import Action, File, FolderChange, Plan, Step
from keymint.store.journal import Intent
from keymint.store.staged import Exchange
from keymint.store.store import Store
from keymint.store.workspace_lock import clock
from keymint.view.stamps import State
from keymint.view.tree import Tree
from keymint.workspace import gitignore
from keymint.workspace.workspace import Workspace

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
    intent: Intent,
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
    guards = gitignore.missing_files(workspace, plan)
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
