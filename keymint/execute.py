# SPDX-License-Identifier: Apache-2.0
"""Carry out a plan: all its steps in one group, marked and recorded."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

from keymint.changes import Action, File, Plan, Step
from keymint.errors import KeymintError
from keymint.plan import gitignore, key_record
from keymint.staged import Staged
from keymint.state import State, dump_mark
from keymint.store import Store
from keymint.tree import Tree
from keymint.workers import Workers
from keymint.workspace import Workspace
from keymint.workspace_lock import clock

RECORD = "state.json"


def open_store(workspace: Workspace) -> Store:
    """Return the store of a workspace: its root, its spaces and a second keystore; ``private`` is private."""
    roots = dict.fromkeys((workspace.root, *workspace.spaces(), workspace.next_install), False)
    return Store(roots | {workspace.private: True}, workspace.state)


def execute(
    plan: Plan, workspace: Workspace, store: Store, before: State, workers: Workers, on_step: Callable[[Step], None]
) -> int:
    """Carry out a plan.

    Args:
        plan: the plan.
        workspace: the workspace.
        store: the writer.
        before: the previous record; written only if it changes.
        workers: the processes that hold a part of what is written.
        on_step: called for every step, after all of them.

    Returns:
        The clock of the file system before anything became visible.

    Raises:
        KeymintError: the system refuses a write; no file is incomplete, and a later run goes on from here.
    """
    guards = gitignore.missing_files(workspace, plan)
    if not guards and not plan.writes() and plan.state == before and not store.is_marked():
        for step in plan.steps:
            on_step(step)
        return clock(workspace.state)
    record = plan.state.dump()
    with store.marked(dump_mark(before, _public(plan), key_record.new_fingerprints(before, plan.state))):
        for guard in guards:  # before the first secret is written
            store.write(guard.folder, guard.files, private=guard.private)
        if plan.first:
            store.change(plan.first)
        staged = _staged(replace(plan, first=()), store, workers)
        visible = clock(workspace.state)
        store.commit(staged)
        for step in plan.steps:
            on_step(step)
        store.write(workspace.state, {RECORD: File(record)})
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


def _staged(plan: Plan, store: Store, workers: Workers) -> list[Staged]:
    """Stage a plan. What other processes hold comes before what is removed."""
    if not any(change.held for change in plan.changes()):
        return [store.stage(plan.changes())]
    removals = replace(plan, steps=tuple(step for step in plan.steps if step.action is Action.REMOVED))
    others = replace(plan, steps=tuple(step for step in plan.steps if step.action is not Action.REMOVED))
    staged: list[Staged] = []
    try:
        staged.append(store.stage(others.changes()))
        staged += workers.stage(store)
        staged.append(store.stage(removals.changes()))
    except BaseException:
        for each in staged:
            store.discard(each)
        raise
    return staged


def _public(plan: Plan) -> Iterator[str]:
    """Yield the digests of the public files that a plan writes."""
    for change in plan.changes():
        yield from (file.digest for file in change.written.values() if not file.secret)
