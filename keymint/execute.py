# SPDX-License-Identifier: Apache-2.0
"""Carry out a plan: all its steps in one group, marked and recorded."""

from __future__ import annotations

from collections.abc import Callable

from keymint.changes import File, Plan, Step
from keymint.plan import gitignore, key_record
from keymint.state import State, dump_mark
from keymint.store import Store
from keymint.workspace import Workspace

RECORD = "state.json"


def open_store(workspace: Workspace) -> Store:
    """Return the store of a workspace: its root and its spaces, of which ``private`` is private."""
    roots = dict.fromkeys((workspace.root, *workspace.spaces()), False)
    return Store(roots | {workspace.private: True}, workspace.state)


def execute(plan: Plan, workspace: Workspace, store: Store, before: State, on_step: Callable[[Step], None]) -> None:
    """Carry out a plan.

    Args:
        plan: the plan.
        workspace: the workspace.
        store: the writer.
        before: the previous record; written only if it changes.
        on_step: called for every step, after all of them.

    Raises:
        KeymintError: the system refuses a write; no file is incomplete, and a later run goes on from here.
    """
    record = plan.state.dump()
    guards = gitignore.missing_files(workspace, plan)
    if not guards and not plan.writes() and record == before.dump() and not store.is_marked():
        for step in plan.steps:
            on_step(step)
        return
    public = [
        file.content
        for step in plan.steps
        for change in step.changes
        for file in change.files.values()
        if not file.secret
    ]
    with store.marked(dump_mark(before, public, key_record.new_fingerprints(before, plan.state))):
        for guard in guards:  # before the first secret is written
            store.write(guard.folder, guard.files, private=guard.private)
        store.change(change for step in plan.steps for change in step.changes)
        for step in plan.steps:
            on_step(step)
        store.write(workspace.state, {RECORD: File(record)})
