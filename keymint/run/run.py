# SPDX-License-Identifier: Apache-2.0
"""One run of a verb: the workspace that it works on, and how plans are made and executed."""

from __future__ import annotations

import contextlib
import fcntl
import functools
import itertools
import shlex
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from comarmor.text import lazy_regex
from comarmor.values import Data, field, replace
from keymint import SPACES, api
from keymint.api.plugin_loader import Plugins, entries_in
from keymint.errors import Diagnostic, ExitCode, KeymintError, Origin, Severity, UnconfirmedError, citation
from keymint.host.streams_and_signals import StoppedError, received_signal
from keymint.output.console import Console, Streams
from keymint.output.report import Report, merged_diagnostics
from keymint.run.execution import RECORD, Workers, execute, next_answer, open_store, record_answer, require_register
from keymint.run.run_log import log_change
from keymint.store.changes import File, Plan, Step
from keymint.store.journal import Journal, intent_of
from keymint.store.store import LOCK, clock, clock_now, path_lock
from keymint.view.recorded_answers import Answer, Call, Sight, is_recordable, known_folders
from keymint.view.stamps import MAX_RECORD, State, load as load_state
from keymint.view.tree import HeldError, Tree, read_file
from keymint.workspace.installed_enclaves import KEY
from keymint.workspace.policy_loading import POLICY
from keymint.workspace.session import Inputs, Session
from keymint.workspace.workspace import Workspace, find, missing_gitignores, shown_path

if TYPE_CHECKING:
    from keymint.host.pool import Pool
    from keymint.pki.tokens.token_sessions import Tokens

_pool = api.lazy("keymint.host.pool:Pool")  # few runs divide work so
_tokens = api.lazy("keymint.pki.tokens.token_sessions:Tokens")  # and few have a key in a token


class Setting(Data):
    """The environment of a run: clock, folders, streams.

    Attributes:
        now: the clock, UTC.
        monotonic: returns seconds, for progress.
        environment: environment variables.
        cwd: current directory.
        cache: cache directory of this user.
        cores: number of processors.
        streams: where output goes.
        call: the command.
        ask: shows a text and returns what the user types, unseen; None if there is no terminal.
        agrees: shows a question and returns whether the user types yes; None unless both standard input and standard
            error are terminals.
        read: returns at most so many bytes of standard input.
        who: returns the names of the user and of the host, for the log of runs.
    """

    now: datetime
    monotonic: Callable[[], float]
    environment: Mapping[str, str] = field(repr=False)
    cwd: Path
    cache: Path
    cores: int
    streams: Streams
    call: Call
    ask: Callable[[str], str] | None = None
    agrees: Callable[[str], bool] | None = None
    read: Callable[[int], bytes] = lambda _most: b""
    who: Callable[[], tuple[str, str]] = lambda: ("", "")


WITHOUT_WORKSPACE = "accept|completion|diff|discover|explain|import|learn|plugins|request|transports"
"""Verbs that take no workspace."""
_COMMAND = lazy_regex(rf"('keymint (?!(?:{WITHOUT_WORKSPACE})\b)(?![^']* -w )[a-z][^']*)'")
"""A command in a message whose verb takes a workspace, and that names none."""
_ExitCodeOf = Callable[[Plan], ExitCode]
"""Returns the exit code of an executed plan."""


def exit_code_of(plan: Plan) -> ExitCode:
    """Return the exit code of an executed plan; an error concerns an enclave that was not changed."""
    failed = any(diagnostic.severity is Severity.ERROR for diagnostic in plan.diagnostics)
    return ExitCode.FAILURE if failed else ExitCode.DONE


def _refuse_to_wait(_process: str) -> None:
    raise KeymintError("another command holds the lock of the workspace", code="not-recorded")


class Run:
    """One run of a verb.

    Args:
        setting: the environment.
        verb: name of the verb.
        options: values of the common options.
    """

    def __init__(self, setting: Setting, verb: str, options: Mapping[str, Any]) -> None:
        self.setting = setting
        self.verb = verb
        self.dry_run: bool = options.get("dry_run", False)
        self.yes: bool = options.get("yes", False)
        """The user agrees to what the run would ask for."""
        self.jobs: int = options.get("jobs") or setting.cores
        self.defaults: Sequence[Any] = options.get("defaults", ())
        """What variables and files set, see :class:`keymint.command_line.defaults.Default`; the strongest first."""
        self.verbosity: int = -1 if options["quiet"] else options["verbose"]
        streams, color = setting.streams, options.get("color") or "auto"
        if color != "auto":
            streams = replace(streams, colour_out=color == "always", colour_err=color == "always")
        self.console = Console(streams, verbosity=self.verbosity, as_json=options["as_json"])
        self._agrees = None if options["quiet"] or options["as_json"] else setting.agrees
        self._agreed: set[Diagnostic] = set()
        """What the user agreed to; a plan may be made twice."""
        self.plugins = Plugins(
            entries_in(setting.call.registrations),
            lambda: api.Environment(setting.now, setting.cache, setting.environment),
        )
        self.crew = Workers(self.jobs if "jobs" in options else 1, setting.monotonic)
        """Who plans packages for the conductor of the stages."""
        self._named: Path | None = options.get("workspace")
        self._spaces: dict[str, Path] = {
            space: folder for space in SPACES if (folder := options.get(f"{space}_space")) is not None
        }
        self.shown_notes: Collection[str] = ()
        """Codes of the notes that are shown although the output is not verbose."""
        self.known_workspace: Workspace | None = None
        self._sight: Sight | None = None
        """The files before a verb that does not write reads them, if its answer may be recorded."""
        self.result: dict[str, Any] = {}
        """What the report of a plan has as result, also if the run stops since nobody agrees to the plan."""
        self.outcome: Mapping[str, Any] = {}
        """What it has in place of that once the plan is carried out: :attr:`lines` are the words for it."""
        self.lines: Sequence[str] = ()
        self.interrupted: Journal | None = None
        """The run before, if it did not come to its end."""
        self.folder_names = {f"{setting.cwd}/": ""}
        """Replacements for the start of paths: of the current directory, and of temporary ones."""

    def typed(self, file: str) -> str:
        """Return a path as the user would type it."""
        for folder, name in self.folder_names.items():
            if file.startswith(folder):
                return name + file.removeprefix(folder)
        return shown_path(Path(file), self.setting.cwd) if file.startswith("/") else file

    def place(self, where: Origin | None) -> str:
        """Return a place as the user would type it, ``file:line``, or an empty text."""
        return citation(self.typed(where.file), where.line, where.source) if where else ""

    def as_typed(self, diagnostic: Diagnostic) -> Diagnostic:
        """Return a diagnostic with all paths, and the workspace of commands, as the user would type them."""
        message, help_ = diagnostic.message, diagnostic.help
        for folder, name in self.folder_names.items():
            message, help_ = message.replace(folder, name), help_.replace(folder, name)
        if self._named not in {None, Path()}:
            name = shlex.quote(str(self._named)).replace("'", '"')
            message, help_ = (_COMMAND.sub(lambda found: f"{found[1]} -w {name}'", text) for text in (message, help_))
        where = diagnostic.where and diagnostic.where.with_files(self.typed)
        return replace(diagnostic, message=message, where=where, help=help_)

    # -- the workspace -------------------------------------------------------------------------------------------

    def workspace(self) -> Workspace:
        """Return the named workspace, or the one that contains the current directory.

        Raises:
            KeymintError: there is none.
        """
        if self.known_workspace is None:
            if self._named is None:
                self.known_workspace = find(self.setting.cwd, self._spaces, self.setting.cwd)
            else:
                self.known_workspace = self.workspace_at(self._named)
                if not self.known_workspace.exists():
                    # The user may have named a folder inside of a workspace.
                    self.known_workspace = find(
                        self.setting.cwd / self._named, self._spaces, self.setting.cwd, self._named
                    )
        return self.known_workspace

    @functools.cached_property
    def tokens(self) -> Tokens:
        """The tokens that the run uses."""
        made: Tokens = _tokens(self.setting.environment, self.setting.ask)
        return made

    def close(self) -> None:
        """Log out of all tokens."""
        if "tokens" in vars(self):
            self.tokens.close()

    def workspace_at(self, folder: Path | None) -> Workspace:
        """Return the workspace at a directory (default: the named or the current one), which may not exist yet."""
        self.known_workspace = Workspace.at(
            self.setting.cwd / (folder or self._named or "."), self._spaces, self.setting.cwd
        )
        return self.known_workspace

    def inputs(self, workspace: Workspace, sight: Sight | None = None) -> Inputs:
        """Return the inputs of a plan for a workspace; its files are read as they are asked for."""
        state = load_state(read_file(workspace.state / RECORD, MAX_RECORD))
        tree = Tree(workspace.install, sight)
        return Inputs(
            workspace, tree, state, self.plugins, self.setting.environment, self.setting.now, lambda: self.tokens
        )

    def snapshot(self, workspace: Workspace, *, auditing: bool = False) -> Inputs:
        """Read a consistent snapshot of a workspace into memory, for verbs that do not write.

        The workspace lock is held only while reading. Arguments as for :meth:`session`.
        """
        for _ in range(2):  # another run may create the lock meanwhile
            waiting = self.console.waiting
            with (
                path_lock(workspace.state / LOCK, fcntl.LOCK_SH, waiting) as locked,
                path_lock(workspace.private, fcntl.LOCK_SH, waiting),
            ):
                if auditing and locked and is_recordable(self.setting.call, str(workspace.root)):
                    self._sight = Sight.of(map(str, workspace.spaces()), clock(workspace.state))
                inputs = self.inputs(workspace, self._sight)
                for space in workspace.spaces():
                    # Other files beside the XML may be large, and are never read.
                    written = space in (workspace.profile, workspace.src)
                    optional = ("" if space == workspace.private else KEY) if auditing else None
                    inputs.tree.hold(space, suffix=".xml" if written else "", optional=optional)
                inputs.tree.hold(workspace.state, suffix="no content")
            if locked or not (workspace.state / LOCK).exists():
                break
        return inputs

    def session(self, *, auditing: bool = False) -> Session:
        """Return a consistent snapshot of the workspace with its profile, for verbs that do not write.

        Args:
            auditing: what the user may not read of the private space counts as absent; the verb reports
                :func:`keymint.examine.keystore.not_examined`.
        """
        return self.snapshot(self.workspace(), auditing=auditing).session()

    @property
    def pool(self) -> Pool:
        """The processes that carry out work that can be divided."""
        pool: Pool = _pool(self.jobs)
        return pool

    # -- what was interrupted ------------------------------------------------------------------------------------

    def intent(self) -> Journal:
        """Return what this run was asked for: the same for the same command with the same files."""
        call = self.setting.call
        return intent_of(call.arguments, Path(call.cwd))

    @property
    def resumes(self) -> bool:
        """Whether all is visible that an interrupted run of this command was asked for: it is not done once more."""
        before = self.interrupted
        return before is not None and before.finished and before.inputs == self.intent().inputs

    def recover(self, workspace: Workspace) -> None:
        """Finish what an interrupted run made visible in part, for verbs that decide something before they plan.

        Args:
            workspace: the workspace, which need not exist.
        """
        store = open_store(workspace)
        if not self.dry_run and store.is_marked():
            with store.locked(self.console.waiting):
                self.interrupted = store.recover()

    def finish(self, workspace: Workspace) -> Report:
        """Report that an interrupted run of this command is finished, and nothing is left to do."""
        return self.carry_out(workspace, lambda inputs: Plan((), inputs.state))

    def told(self, report: Report) -> Report:
        """Return a report that says what became of an interrupted run."""
        found = self.interrupted.outcome(self.intent()) if self.interrupted else None
        return replace(report, diagnostics=(*report.diagnostics, found)) if found else report

    # -- what the user must agree to -----------------------------------------------------------------------------

    def confirm(self, reasons: Sequence[Diagnostic], show: Callable[[], None] = lambda: None) -> tuple[Diagnostic, ...]:
        """Stop the run unless the user agrees: by ``--yes``, or on a terminal when asked; without reasons it goes on.

        A verb that may take away what the user did not mean to has ``@verb(yes=True)``, and calls this while it plans,
        so before anything is written. Nothing is asked with ``--json`` or ``-q``, and by a dry run.

        Args:
            reasons: warnings, each with what would be lost.
            show: shows more about it, before the question or the errors.

        Returns:
            The reasons, to be told with the plan; of a dry run also that the run would ask. None if they were shown
            with the question.

        Raises:
            UnconfirmedError: nobody agreed; exit code 3, with the reasons as errors.
        """
        if self.yes or self.dry_run:
            stops = Diagnostic.warning(
                "not-confirmed", "the run itself asks first", None, "if this is wanted, add --yes"
            )
            return (*reasons, *([stops] if reasons and not self.yes else ()))
        if self._agreed.issuperset(reasons):
            return ()
        show()
        if self._agrees is None:
            stopped = Diagnostic.error("not-confirmed", "nothing was written", None, "if this is wanted, add --yes")
        else:
            self.console.diagnostics([*map(self.as_typed, reasons)])
            if self._agrees("Go on? [y/N] "):
                self._agreed.update(reasons)
                return ()
            reasons, stopped = (), Diagnostic.error("not-confirmed", "nothing was written, as you answered")
        errors = (replace(each, severity=Severity.ERROR) for each in reasons)
        raise UnconfirmedError.of([*errors, stopped], ExitCode.FINDINGS)

    # -- doing it ------------------------------------------------------------------------------------------------

    def change(self, make_plan: Callable[[Session], Plan], exit_code: _ExitCodeOf = exit_code_of) -> Report:
        """Carry out a plan for the workspace and its profile; see :meth:`carry_out`."""
        return self.carry_out(self.workspace(), lambda inputs: make_plan(inputs.session()), exit_code)

    def carry_out(
        self, workspace: Workspace, make_plan: Callable[[Inputs], Plan], exit_code: _ExitCodeOf = exit_code_of
    ) -> Report:
        """Plan, execute the plan under the workspace lock, and return the report.

        A new workspace is planned before anything is written, including the lock.

        Args:
            workspace: the workspace.
            make_plan: makes the plan.
            exit_code: returns the exit code of an executed plan.
        """

        def planned_from(inputs: Inputs) -> Plan:
            self.crew.close()  # those of an earlier plan
            try:
                plan = make_plan(inputs)
            except HeldError:
                self.crew.give_up()
                plan = make_plan(inputs)
            if number := received_signal():  # it arrived where nothing could be raised, e.g. in a finaliser
                raise StoppedError(number)
            return plan

        with contextlib.closing(self.crew), contextlib.closing(self):
            report = self._carry_out(workspace, planned_from, exit_code)
        self.console.messages(self.lines)
        return replace(report, result=self.outcome) if self.outcome else report

    def _carry_out(self, workspace: Workspace, make_plan: Callable[[Inputs], Plan], exit_code: _ExitCodeOf) -> Report:
        if self.dry_run:
            plan = make_plan(self.snapshot(workspace))
            return self.report(
                self.outcome or self.result, plan.diagnostics, exit_code(plan), workspace=workspace, steps=plan.steps
            )
        planned: tuple[Inputs, Plan, Sight] | None = None
        if not workspace.state.is_dir():
            sight = Sight.of(map(str, workspace.spaces()))
            inputs = self.inputs(workspace)
            try:
                planned = inputs, make_plan(inputs), sight
            except KeymintError:
                if not workspace.state.is_dir():
                    raise
                # Another run creates this workspace, and was seen half-way: plan again once it is done.
        store = open_store(workspace)
        with store.locked(self.console.waiting):
            self.interrupted = store.recover()
            # If this workspace is new, the private space is that of another one.
            shared = not store.missing
            if planned is None or shared or workspace.exists() or workspace.state.joinpath(RECORD).exists():
                planned = self._planned_again(workspace, make_plan)
            below = tuple(f"{root}/" for root in store.missing)
            writes_there = any(f"{folder}/".startswith(below) for folder, _, _ in planned[1].names())
            if writes_there and store.lock_missing(self.console.waiting):
                planned = self._planned_again(workspace, make_plan)
            (inputs, plan, sight), planned = planned, None
            require_register(plan, inputs)
            guards = missing_gitignores(workspace, plan)
            intent = self.intent()
            who = self.setting.who() if plan.writes() else ("", "")
            log = log_change(inputs, plan, self.verb, f"{intent.command}{' --yes' * self.yes}", who, self.setting.now)

            @functools.cache
            def results() -> tuple[Plan, Report, tuple[Session, Answer] | None]:
                done = plan.carried_out(POLICY)
                outcome, code = self.outcome or self.result, exit_code(done)
                report = self.report(outcome, done.diagnostics, code, workspace=workspace, steps=done.steps)
                return done, report, next_answer(self.setting.call, inputs, done, self.presented(report), self.console)

            visible = execute(plan, inputs, store, self.crew, intent, guards, log, results)
            written = clock_now(workspace.state)  # what comes now takes as long as the clock needs to move on
            plan, report, answer = results()
            if answer:
                store.seen.update(self.crew.seen())
                beside = ((str(each.folder), each.written, each.removed) for each in itertools.chain(guards, log))
                names = itertools.chain(beside, plan.names())
                # As late as possible: the clock of the file system must have moved on.
                if after := sight.after(names, visible, clock(workspace.state, written), store.seen):
                    record_answer(self.setting.call, answer[0], after, (), answer[1], store)
            store.end()
        return report

    def _planned_again(self, workspace: Workspace, make_plan: Callable[[Inputs], Plan]) -> tuple[Inputs, Plan, Sight]:
        """Plan under the workspace lock; return what the plan was made from, the plan, and the folders as they are."""
        spaces = [str(space) for space in workspace.spaces()]
        known = known_folders(self.setting.call, str(workspace.root), spaces)
        sight = Sight.of(spaces, clock(workspace.state), known)
        inputs = self.inputs(workspace, sight)
        return inputs, make_plan(inputs), sight

    def report(
        self,
        result: Mapping[str, Any] | None = None,
        diagnostics: Sequence[Diagnostic] = (),
        exit_code: ExitCode = ExitCode.DONE,
        *,
        workspace: Workspace | None = None,
        steps: Sequence[Step] = (),
        notes: bool | Collection[str] = False,
    ) -> Report:
        """Return the report of the verb; arguments as the fields of a report."""
        return Report(
            self.verb, workspace, steps, diagnostics, result or {}, exit_code, self.dry_run, notes or self.shown_notes
        )

    def presented(self, report: Report) -> Report:
        """Return a report with all paths as the user would type them, and equal diagnostics merged."""
        return replace(report, diagnostics=merged_diagnostics([self.as_typed(each) for each in report.diagnostics]))

    def remember(
        self, session: Session, dates: Iterable[datetime], report: Report, show: Callable[[Console], None]
    ) -> None:
        """Record what a verb shows that does not write, for the same command.

        Args:
            session: the snapshot of the verb.
            dates: dates at which it may show something else.
            report: its report; one with diagnostics is not recorded.
            show: shows what comes before the report.
        """
        sight = self._sight and self._sight.after((), self._sight.clock, self._sight.clock, {})
        if not sight or not is_recordable(self.setting.call, str(session.workspace.root)):
            return
        out, err = self.console.rendered(report, show)
        if err:  # results and diagnostics would be shown in another order
            return
        store, answer = open_store(session.workspace), Answer(out, err, int(report.exit_code))
        with contextlib.suppress(KeymintError), store.locked(_refuse_to_wait):
            if not store.is_marked():
                record_answer(self.setting.call, session, sight, dates, answer, store)

    def keep(self, inputs: Inputs, state: State) -> tuple[Diagnostic, ...]:
        """Save the results of a verb that does not write, unless the workspace changed meanwhile.

        Args:
            inputs: the snapshot of the verb.
            state: the record with its results.

        Returns:
            A note if the record cannot be written, e.g. on a read-only file system, or as another command is running:
            a reader waits for no other one.
        """
        workspace = inputs.workspace
        if self.dry_run or inputs.tree.remnants or state is inputs.state or state.dump() == inputs.state.dump():
            return ()
        store = open_store(workspace)
        try:
            with store.locked(_refuse_to_wait):
                if not store.is_marked() and self.inputs(workspace).state == inputs.state:
                    store.write(workspace.state, {RECORD: File(state.dump())})
        except KeymintError as error:
            message = f"the results are not cached: {error.diagnostics[0].message}"
            return (Diagnostic.note("not-recorded", message, error.diagnostics[0].where),)
        return ()
