# SPDX-License-Identifier: Apache-2.0
"""Carry out a plan step by step, and report each step."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import groupby

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


def execute(
    plan: Plan, workspace: Workspace, store: Store, before: State, jobs: int, on_step: Callable[[Step], None]
) -> None:
    """Carry out a plan.

    Args:
        plan: the plan.
        workspace: the workspace.
        store: the writer.
        before: the previous record; written only if it changes.
        jobs: threads that write at the same time.
        on_step: called after every step.

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
        for batch in _batches(plan.steps):
            _carry_out(batch, store, jobs, on_step)
        store.write(workspace.state, {RECORD: File(record)})


def _batches(steps: Sequence[Step]) -> Iterator[Sequence[Step]]:
    """Yield the steps stage by stage, so that a stage is written before the next one begins."""
    for _, batch in groupby(steps, key=lambda step: (step.stage, not step.package)):
        yield tuple(batch)


def _carry_out(steps: Sequence[Step], store: Store, jobs: int, on_step: Callable[[Step], None]) -> None:
    # Packages below one namespace stay in one thread: an outer enclave is created before the ones inside it.
    ordered = sorted(steps, key=lambda step: step.package)
    groups = [tuple(group) for _, group in groupby(ordered, key=lambda step: step.package.split("/")[0])]

    def write(group: Sequence[Step]) -> Sequence[Step]:
        store.change(change for step in group for change in step.changes)
        return group

    with ThreadPoolExecutor(max(jobs, 1)) as pool:
        try:
            for written in (pool.map if jobs > 1 and len(groups) > 1 else map)(write, groups):
                for step in written:
                    on_step(step)
        except BaseException:
            pool.shutdown(wait=True, cancel_futures=True)
            raise
