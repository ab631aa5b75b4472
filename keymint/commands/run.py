"""One run of a verb: the workspace that it works on, and how plans are made and executed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

from comarmor.errors import Diagnostic, Severity
from comarmor.text import did_you_mean
from keymint.api import Environment
from keymint.changes import File, Plan
from keymint.errors import ExitCode, KeymintError
from keymint.execute import RECORD, execute, open_store
from keymint.names import package_name
from keymint.output.console import Console, Streams
from keymint.output.report import Report
from keymint.plugins import Plugins
from keymint.session import Inputs
from keymint.state import MAX_RECORD, State
from keymint.state import load as load_state
from keymint.tree import Tree, read_file
from keymint.workspace import SPACES, Workspace, find, packages
from keymint.workspace_lock import LOCK, shared


@dataclass(frozen=True, slots=True)
class Setting:
    """What only the command line knows; everything below gets it from here.

    Attributes:
        now: the clock, UTC.
        monotonic: returns seconds, for progress.
        environment: environment variables.
        cwd: current folder.
        cache: folder of this user for what can be made again.
        cores: number of processors.
        streams: where output goes.
    """

    now: datetime
    monotonic: Callable[[], float]
    environment: Mapping[str, str] = field(repr=False)
    cwd: Path
    cache: Path
    cores: int
    streams: Streams


class Run:
    """One verb under way.

    Args:
        setting: what the command line knows.
        verb: the verb's name.
        options: the values of the options that all verbs share.
    """

    def __init__(self, setting: Setting, verb: str, options: Mapping[str, Any]) -> None:
        self.setting = setting
        self.verb = verb
        self.dry_run: bool = options.get("dry_run", False)
        self.jobs: int = options.get("jobs") or setting.cores
        self.console = Console(
            setting.streams,
            verbosity=-1 if options["quiet"] else options["verbose"],
            as_json=options["as_json"],
        )
        self.plugins = Plugins(environment=Environment(setting.now, setting.cache, setting.environment))
        self._named: Path | None = options.get("workspace")
        self._spaces: dict[str, Path] = {
            space: folder for space in SPACES if (folder := options.get(f"{space}_space")) is not None
        }
        self.known_workspace: Workspace | None = None

    # -- the workspace -------------------------------------------------------------------------------------------

    def workspace(self) -> Workspace:
        """Return the workspace that is named, or that the current folder lies in.

        Raises:
            KeymintError: there is none.
        """
        if self.known_workspace is None:
            if self._named is None:
                self.known_workspace = find(self.setting.cwd, self._spaces, self.setting.cwd)
            else:
                self.known_workspace = self.workspace_at(self._named)
                if not self.known_workspace.exists():
                    # Looking upward from a folder that was named helps whoever names a folder inside of it.
                    self.known_workspace = find(self.setting.cwd / self._named, self._spaces, self.setting.cwd)
        return self.known_workspace

    def workspace_at(self, folder: Path | None) -> Workspace:
        """Return the workspace at a folder (by default the named or the current one), whether or not it exists."""
        self.known_workspace = Workspace.at(
            self.setting.cwd / (folder or self._named or "."), self._spaces, self.setting.cwd
        )
        return self.known_workspace

    def inputs(self, workspace: Workspace) -> Inputs:
        """Return what stages plan from, as it is now."""
        record, mark = (read_file(workspace.state / name, MAX_RECORD) for name in (RECORD, "running"))
        state = load_state(record, mark)
        return Inputs(workspace, Tree(), state, self.plugins, self.setting.environment, self.setting.now)

    def snapshot(self, workspace: Workspace) -> Inputs:
        """Return what verbs that only look read from: all of it as it is at one moment, when no run is under way.

        The lock is held while it is read into memory, and no longer: what is made of it may take its time.
        """
        for _ in range(2):  # a run may make the lock while a workspace without one is read
            with shared(workspace.state, self.console.waiting) as locked:
                inputs = self.inputs(workspace)
                for space in workspace.spaces():
                    # What else lies beside people's own files may be large, and is never read.
                    written = space in (workspace.profile, workspace.src)
                    inputs.tree.hold(space, suffix=".xml" if written else "")
                inputs.tree.hold(workspace.state, suffix="no content")
            if locked or not (workspace.state / LOCK).exists():
                break
        return inputs

    def names(self, inputs: Inputs, given: tuple[str, ...]) -> tuple[str, ...]:
        """Return the packages that a user named, or all of them.

        Raises:
            KeymintError: one is not legal, or is not a package of the workspace.
        """
        known = packages(inputs.tree, inputs.workspace.src)
        if not given:
            return known
        names = tuple(dict.fromkeys(package_name(name) for name in given))
        for name in names:
            if name not in known:
                raise KeymintError(
                    f"no package {name!r} in {inputs.workspace.shown(inputs.workspace.src)}",
                    help=did_you_mean(name, known, f"'keymint create {name}' makes it"),
                    code="package-unknown",
                )
        return names

    # -- doing it ------------------------------------------------------------------------------------------------

    def carry_out(self, workspace: Workspace, make_plan: Callable[[Inputs], Plan]) -> Report:
        """Plan, carry the plan out under the workspace's lock, and return the report.

        A workspace that does not exist yet is planned before its first byte is written, lock included.
        """
        if self.dry_run:
            plan = make_plan(self.snapshot(workspace))
            return Report(self.verb, workspace, plan.steps, plan.diagnostics, {}, _exit_code(plan), dry_run=True)
        planned: tuple[Inputs, Plan] | None = None
        if not workspace.state.is_dir():
            inputs = self.inputs(workspace)
            planned = (inputs, make_plan(inputs))
        store = open_store(workspace)
        with store.locked(self.console.waiting):
            store.sweep()
            if planned is None or workspace.exists() or workspace.state.joinpath(RECORD).exists():
                inputs = self.inputs(workspace)
                planned = (inputs, make_plan(inputs))
            inputs, plan = planned
            with self.console.progress(len(plan.steps), self.setting.monotonic) as advance:
                execute(plan, workspace, store, inputs.state, self.jobs, advance)
        return Report(self.verb, workspace, plan.steps, plan.diagnostics, {}, _exit_code(plan))

    def keep(self, inputs: Inputs, state: State) -> tuple[Diagnostic, ...]:
        """Record what a verb found out that only looks, unless something changed in the workspace meanwhile.

        Args:
            inputs: the snapshot that it looked at.
            state: the record with what it found out.

        Returns:
            A note where the record cannot be written, e.g. on a read-only file system; that is no defect.
        """
        workspace = inputs.workspace
        if self.dry_run or inputs.state.interrupted or state.dump() == inputs.state.dump():
            return ()
        store = open_store(workspace)
        try:
            with store.locked(self.console.waiting):
                if not store.is_marked() and self.inputs(workspace).state == inputs.state:
                    store.write(workspace.state, {RECORD: File(state.dump())})
        except KeymintError as error:
            message = f"what was found out is not recorded: {error.diagnostics[0].message}"
            return (Diagnostic("not-recorded", Severity.NOTE, message, error.diagnostics[0].where),)
        return ()


def _exit_code(plan: Plan) -> ExitCode:
    """Return the exit code of a plan that was carried out: an error is about an enclave that was left as it is."""
    failed = any(found.severity is Severity.ERROR for found in plan.diagnostics)
    return ExitCode.FAILURE if failed else ExitCode.DONE
