# SPDX-License-Identifier: Apache-2.0
"""Processes that plan, and the carrying out of a plan: all its steps in one group, visible as a whole or not at all.

What the command will print if it is given again is recorded, so that it need not be carried out; see ADR 0002.

Each process plans a part of the packages, and keeps the bytes that it planned until these are written; so does the
parent. The others are forked, so that they begin with everything that was loaded. They send plans without bytes, so no
key leaves them. Nothing is written until the plans of all packages have arrived and are right; then each process stages
its part, and the parent commits all parts together.

A process goes through all stages with some hundred packages, packs what it planned for them, and begins with the next
ones: so its memory has no more than these in full.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import sys
import threading
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from datetime import datetime
from functools import partial
from operator import attrgetter
from typing import TYPE_CHECKING, Any, BinaryIO

from comarmor.values import replace
from keymint.api import lazy
from keymint.authority.authorities import STAGE as AUTHORITIES
from keymint.errors import KeymintError, process_ended
from keymint.life.examine import IGNORED, ORPHANED, RIGHTS_OUTLIVE
from keymint.life.revocation_lists_in_force import loaded_lists
from keymint.output.console import Console
from keymint.output.report import Report
from keymint.stages.work import Crew, NewPackages, PackagePlan, PackageStage, planned_apart
from keymint.store.changes import Action, File, FolderChange, HeldChanges, Plan, Step
from keymint.store.file_writing import c_function, open_at, reported, sync_file_system
from keymint.store.journal import Journal
from keymint.store.staged import Exchange
from keymint.store.store import Store, clock
from keymint.view.recorded_answers import Answer, Call, FolderStatus, Sight, is_recordable, name_of, record
from keymint.view.stamps import Stamp, digest, one_of
from keymint.view.tree import Place, Tree
from keymint.workspace.package_build_types import BUILD, may_share
from keymint.workspace.policy_loading import recorded_files
from keymint.workspace.session import Inputs, Session
from keymint.workspace.workspace import Workspace

if TYPE_CHECKING:
    from queue import SimpleQueue

    from keymint.host.pool import Forked

# A run in one process needs none of these.
_dumps, _loads, _queue = lazy("pickle:dumps"), lazy("pickle:loads"), lazy("queue:SimpleQueue")
_fork, _send, _receive = (lazy(f"keymint.host.pool:{name}") for name in ("Forked", "send", "receive"))

MIN_PACKAGES = 64
"""Packages from which on processes are worth their start."""
FIRST = 8
"""Packages that are planned before the processes start, which begin with what was learned of their kinds."""
MOST_PACKAGES = 512
"""About how many packages a process has in full."""
MOST_OWN = 2_000
"""Packages up to which the parent plans some itself; what it keeps of many takes the memory for that."""
COMMON_WORK = 0.05
"""What the parent does for all packages while they are planned, compared with planning them."""

_WRITING = 3
"""Stages that have a step for each package."""
_PART, _DONE, _REFUSED, _CRASHED = "part", "done", "refused", "crashed"
"""Kinds of answers of a process: some plans of a stage, the last ones, and errors."""
_Stages = Sequence[Callable[[Session], PackageStage]]
_Task = tuple[Session, Sequence[str], _Stages, NewPackages | None]
"""The workspace, the packages to plan, what makes each stage, and the packages that are new, if some may be."""
_OTHERS = attrgetter(*(name for name in PackagePlan.__annotations__ if name not in {"name", "step", "stamp"}))
_Files = Sequence[FolderChange]  # changes that belong to no step
_Changes = Sequence[Sequence[Iterable[FolderChange]]]
"""The changes of each stage, in parts."""


class Workers(Crew):
    """The processes of one run, the caller's included; if it starts no others, it plans everything.

    Args:
        count: the most processes.
        monotonic: returns seconds.
    """

    def __init__(self, count: int, monotonic: Callable[[], float]) -> None:
        self._count = count
        self.monotonic = monotonic
        self._have_staged = False
        self._processes: list[Forked] = []
        self._own: list[tuple[Any, ...]] = []
        """What this process answers itself."""
        self._sources: Sequence[Callable[[], Any]] = ()
        """What returns the next answer of each process, this one first."""

    def start(self, session: Session, names: Sequence[str], stages: _Stages) -> None:
        """See :meth:`keymint.stages.work.Crew.start`."""
        parts = _parts(names, _shares(len(names), self._count))
        # A thread of this process would not be there in a forked one, but the locks that it holds would.
        if len(names) < MIN_PACKAGES or len(parts) == 1 or threading.active_count() > 1 or not hasattr(os, "fork"):
            return
        if may_share(session, names):
            return
        # A module of a token must not be used in a forked process (PKCS #11, C_Initialize), and one session is enough.
        if any(authority.certificate.key.uri for authority in session.profile.authorities):
            return
        # What the first packages need is imported, compiled and proven once for all processes.
        with contextlib.suppress(KeymintError):
            for _ in planned_apart(session, names[:FIRST], stages, self.new):
                pass
        _trim(len(names))  # the processes inherit what the parsed policy took and is free
        try:
            for part in parts[1:]:
                _fork(partial(_work, (session, part, stages, self.new)), self._processes)
        except OSError:  # the system has no room for another process
            self.give_up()
            return
        self._sources = [partial(self._own.pop, 0), *(each.receive for each in self._processes)]
        with _refusing(self._own.append):
            for planned in planned_apart(session, parts[0], stages, self.new):
                self._own.append((_DONE, planned))

    def planned(self, stage: PackageStage, names: Sequence[str]) -> list[Any]:
        """See :meth:`keymint.stages.work.Crew.planned`."""
        if not self._processes:
            return super().planned(stage, names)
        found = (each for source in self._sources for part in _answers(source) for each in part)
        return [_plan_of(each) if isinstance(each, tuple) else each for each in found]

    def stage(self, store: Store, changes: Iterable[FolderChange], meanwhile: Callable[[], object]) -> list[Exchange]:
        """Let the processes stage what they planned, and return it in the order of stages.

        Args:
            store: stages what this process has, and discards what some staged if others fail.
            changes: what this process has, which comes first.
            meanwhile: called when this process has staged its part.

        Raises:
            KeymintError: the system refuses a write; what was staged is discarded, as it is if a signal ends the run.
        """
        self._have_staged = True
        for process in self._processes:
            process.tell(store.common)
        by_process: list[list[Sequence[Exchange]]] = []
        failed: BaseException | None = None

        def own() -> Iterator[list[Sequence[Exchange]]]:
            yield [store.stage(changes)]
            meanwhile()

        for answers in (own(), *map(_answers, self._sources[1:])):
            try:
                by_process += answers
            except BaseException as error:  # noqa: BLE001 - it is raised below
                failed = error
                # What others stage is discarded as well, so this waits for them, but not if a signal ends the run.
                if not isinstance(error, KeymintError):
                    self.close()
                    break
        if failed:
            for staged in itertools.chain(*by_process):
                store.discard(staged)
            raise failed
        of_stages = itertools.zip_longest(*by_process, fillvalue=())
        return [each for of_stage in of_stages for staged in of_stage for each in staged]

    def seen(self) -> Iterator[tuple[str, FolderStatus]]:
        """Yield the status of the new folders that the processes staged; it takes memory, so it is asked late."""
        with contextlib.suppress(KeymintError):  # a process ended: then the folders are looked at again
            for source in self._sources[1:] if self._have_staged else ():
                for folders, *columns in filter(None, _answers(source)):
                    yield from zip(folders, map(FolderStatus, *columns), strict=True)

    def give_up(self) -> None:
        """End all processes, and start no others: the caller's process plans everything."""
        self.close()
        self._count = 1

    def close(self) -> None:
        """End all processes; what they did not stage is lost."""
        for process in self._processes:
            process.end()
        self._processes.clear()
        self._own.clear()


def _shares(size: int, count: int) -> list[float]:
    """Return what share of some packages each process plans, this one first."""
    own = max(0.0, (1 - COMMON_WORK * (count - 1)) / count) if size <= MOST_OWN else 0.0
    others = count - (own > 0)
    return [own, *[(1 - own) / others] * others] if count > 1 else [1]


def _trim(packages: int) -> None:
    """Give memory that is free back to the system, which the library keeps for later, if a fleet is large."""
    if packages > MOST_OWN and (trim := c_function("malloc_trim")):
        trim(0)


def _parts(names: Sequence[str], shares: Sequence[float]) -> list[list[str]]:
    """Divide sorted names by shares, about; what lies in one folder stays together, below a common one."""
    common = os.path.commonpath([name.rpartition("/")[0] for name in names]) if names else ""
    level = common.count("/") + 1 if common else 0
    parts, ends, done = [list[str]()], [*itertools.accumulate(shares)], 0
    for _, group in itertools.groupby(names, key=lambda name: name.split("/")[level]):
        if len(parts) < len(shares) and done >= ends[len(parts) - 1] * len(names):
            parts.append([])
        parts[-1] += (of_group := [*group])
        done += len(of_group)
    return parts


class PackedChanges:
    """Changes that take little memory until they are staged.

    Keys are kept as they are: none is in one compressed text with other files.

    Args:
        changes: the changes.
    """

    def __init__(self, changes: Iterable[FolderChange]) -> None:
        self._secrets: list[dict[str, File]] = []
        public: list[FolderChange] = []
        for each in changes:
            self._secrets.append({name: file for name, file in each.files.items() if file.secret})
            public.append(replace(each, files={name: file for name, file in each.files.items() if not file.secret}))
        self._packed = zlib.compress(_dumps(public), 1)
        self._digest = digest(self._packed)

    def __iter__(self) -> Iterator[FolderChange]:
        if digest(self._packed) != self._digest:
            raise ValueError("what was planned is damaged in memory")
        public = _loads(zlib.decompress(self._packed))
        for each, secret in zip(public, self._secrets, strict=True):
            yield replace(each, files={**each.files, **secret})


@contextlib.contextmanager
def _refusing(send: Callable[[tuple[Any, ...]], object]) -> Iterator[None]:
    """Answer that a process cannot do its part, if so."""
    try:
        yield
    except KeymintError as error:
        send((_REFUSED, error.diagnostics, error.exit_code))


def _answers(receive: Callable[[], Any]) -> Iterator[list[Any]]:
    """Yield the parts of what a process answers, each as it was received."""
    kind = _PART
    while kind == _PART:
        try:
            kind, *answer = receive()
        except (EOFError, OSError):
            raise process_ended("worker-ended") from None
        if kind == _REFUSED:
            raise KeymintError.of(*answer)
        if kind == _CRASHED:
            message, trace = answer
            error = RuntimeError(message)
            error.add_note(trace)
            raise error
        yield answer[0]


def _work(task: _Task, told: BinaryIO, pipe: BinaryIO) -> None:
    """Plan packages and send the plans stage by stage; stage them when the parent says so.

    This runs in a process of its own. The system begins to write what all processes staged once this one has half of
    its part; the parent, which synchronises everything, is told what could not be written.
    """
    answers: SimpleQueue[bytes | None] = _queue()

    def deliver() -> None:
        with contextlib.suppress(OSError):  # the parent ended
            for answer in iter(answers.get, None):
                if answer:
                    _send(pipe, answer)
                    continue
                with contextlib.suppress(OSError), open_at(task[0].workspace.state) as opened:
                    sync_file_system(opened)

    def send(answer: tuple[Any, ...]) -> None:
        answers.put(_dumps(answer))

    # A pipe takes little before the parent reads, which plans a part itself: this process must not wait for that.
    sender = threading.Thread(target=deliver, daemon=True)
    sender.start()
    try:
        with _refusing(send):
            changes = _planned_in_parts(answers.put, task)
            store = open_store(task[0].workspace)
            store.common.update(_receive(told))  # if the parent ended, nobody reads the error of this
            staged: list[list[Exchange]] = []
            for of_stage in changes:
                if of_stage is changes[len(changes) // 2]:
                    answers.put(b"")
                staged.append([each for part in of_stage for each in store.stage(part)])
            # All plans were received, so this need not wait for the thread, which may synchronise.
            _send(pipe, _dumps((_DONE, staged)))
            seen = [(folder, *status) for folder, status in store.seen.items()]
            for at in range(0, len(seen), MOST_PACKAGES):  # columns take less time
                _send(pipe, _dumps((_PART, [*zip(*seen[at : at + MOST_PACKAGES], strict=True)])))
            _send(pipe, _dumps((_DONE, ())))
    except Exception as error:  # noqa: BLE001 - the parent reports it
        import traceback  # noqa: PLC0415 - few runs need it

        send((_CRASHED, f"{type(error).__name__}: {error}", traceback.format_exc()))
    answers.put(None)
    sender.join()


def _planned_in_parts(send: Callable[[bytes], object], task: _Task) -> _Changes:
    """Plan packages part by part, send the plans of all of them stage by stage, and return the changes of each stage.

    Plans that must wait for those of other parts are kept as they are sent, which takes less memory.

    Raises:
        KeymintError: a stage cannot plan; the plans of all stages before it are sent.
    """
    session, names, stages, new = task
    number_of_parts = max(1, round(len(names) / MOST_PACKAGES))
    parts = _parts(names, [1 / number_of_parts] * number_of_parts)
    answers: list[list[bytes]] = [[] for _ in stages]
    changes: list[list[Iterable[FolderChange]]] = [[] for _ in stages]
    refused: KeymintError | None = None
    for part in parts:
        is_last, done = part is parts[-1], 0
        planned = planned_apart(session.apart(), part, stages[: len(answers)], new)
        try:
            for of_stage, kept, found in zip(answers, changes, planned, strict=False):
                plans = [_row(each) if isinstance(each, PackagePlan) else each for each in found]
                of_stage.append(_dumps((_DONE if is_last else _PART, plans)))
                steps = [each.step for each in found if isinstance(each, PackagePlan) and each.step]
                changed = [change for step in steps for change in step.changes]
                kept.append(PackedChanges(changed) if len(parts) > 1 else changed)
                while is_last and of_stage:
                    send(of_stage.pop(0))
                done += 1
            # A package may have errors, which the parent reports without what comes after it.
            refused = refused if done == len(answers) else None
        except KeymintError as error:
            refused = error
        del answers[done:]
    if refused:
        raise refused
    return changes


def _row(plan: PackagePlan) -> tuple[Any, ...]:
    """Return a plan without the bytes of its files, as values that take little time to send; see :func:`_plan_of`."""
    step, stamp, places, changes = plan.step, plan.stamp, list[Place](), list[tuple[Any, ...]]()
    known = stamp.outputs if isinstance(stamp, Stamp) else {}
    for each in step.changes if step else ():
        folder, files = str(each.folder), each.files
        held = {name: file.digest for name, file in files.items()}
        changes.append((folder, each.removed, each.private, held))
        around = folder.removesuffix(f"/{plan.name}")
        is_known = all(held[name] == known.get(name, held[name] if file.secret else "") for name, file in files.items())
        if is_known and around != folder and not each.removed:
            places.append(one_of((f"{around}/", tuple(held), each.private)))
    written = one_of(tuple(places)) if stamp and len(places) == len(changes) else changes
    return (
        plan.name,
        step and (step.stage, step.package, step.action, written, step.detail, step.sizes),
        stamp,
        _OTHERS(plan),
    )


def _plan_of(row: tuple[Any, ...]) -> PackagePlan:
    """Return the plan of a row; what many plans have in common is kept once."""
    name, step, stamp, others = row
    name = sys.intern(name)
    if step:
        stage, package, action, written, detail, sizes = step
        changes: Any = (
            HeldChanges(name, one_of(written), stamp)
            if written and isinstance(written, tuple)
            else tuple([FolderChange(folder, {}, *more) for folder, *more in written])
        )
        step = Step(stage, package and name, action, changes, one_of(detail), sizes and one_of(sizes))
    return PackagePlan(name, step, stamp, *others)


# -- carrying out ----------------------------------------------------------------------------------------------------

RECORD = "state.json"
_TOLD_ONCE = {
    RIGHTS_OUTLIVE, "node-cannot-start", "parameter-client-cannot-start", "policy-replaced", "profile-copied",
    "profile-name-twice", "profile-wide", "rights-lost", "rights-unread", "subject-stripped",
}  # fmt: skip
"""Codes of what is told only by a run that does something: signed rights became narrower, and slips in the policy."""
_TOLD_ANYWAY = {"distro-unnamed", "domain-environment", "element-renamed", "authority-key-missing", ORPHANED, IGNORED}
"""Codes of what each run finds out, whichever packages it looks at."""


def open_store(workspace: Workspace) -> Store:
    """Return the store of a workspace: its root, its spaces and a second keystore; ``private`` is private."""
    roots = dict.fromkeys((workspace.root, *workspace.spaces(), workspace.next_install), False)
    return Store(roots | {workspace.private: True}, workspace.state)


def execute(
    plan: Plan,
    inputs: Inputs,
    store: Store,
    workers: Workers,
    intent: Journal,
    guards: _Files,
    log: _Files,
    meanwhile: Callable[[], object],
) -> int:
    """Carry out a plan.

    Args:
        plan: the plan.
        inputs: the workspace before it; the record is written only if it changes.
        store: the writer.
        workers: the processes that hold a part of what is written.
        intent: what the run was asked for.
        guards: the missing ``.gitignore`` files.
        log: what adds the run to the log.
        meanwhile: called while other processes stage, and the system writes what was staged, if that is much.

    Returns:
        The clock of the file system before anything became visible.

    Raises:
        KeymintError: the system refuses a write; no file is incomplete, and the next run finishes it, or drops it.
    """
    folder = inputs.workspace.state
    staged: Sequence[Exchange] = ()
    if guards or plan.writes() or plan.state != inputs.state:
        changing = {step.package for step in plan.steps if step.package and step.writes()}
        store.begin(replace(intent, packages=tuple(sorted(changing))))
        # The record of a large fleet is made as it is written.
        record = FolderChange(folder, {RECORD: File(plan.state.pieces)})
        staged = _staged(plan, guards, (*log, record), store, workers, meanwhile)
    visible = clock(folder)
    store.commit(staged)
    return visible


def require_register(plan: Plan, inputs: Inputs) -> None:
    """Require that the register which a plan replaces is the one that it was made from.

    A workspace that shares the private space writes it, too, and not every file system has locks.

    Args:
        plan: the plan.
        inputs: what the plan was made from.

    Raises:
        KeymintError: it is another one, so that serial numbers or revocations would be lost.
    """
    path = inputs.workspace.register
    is_replaced = any(str(change.folder) == str(path.parent) and path.name in change.files for change in plan.first)
    if is_replaced and Tree().digest(path) != inputs.tree.digest(path):
        raise KeymintError(
            "was changed by another run meanwhile, so nothing was written",
            where=inputs.workspace.origin(path),
            help="run the command again",
            code="register-changed",
        )


def _staged(
    plan: Plan, guards: _Files, records: _Files, store: Store, workers: Workers, meanwhile: Callable[[], object]
) -> Sequence[Exchange]:
    """Stage a plan and its records. What other processes hold comes before what is removed."""
    folders = [str(change.folder) for change in plan.changes() if change.held]
    held = [*plan.held()]
    if not folders and not held:
        store.change(guards)  # before the first secret is written
        return store.stage((*plan.changes(), *records))
    names = [each.name for each in held]
    around = {place for each in held for place, *_ in each.places}
    places = (*folders, *(f"{place}{end(names)}" for place in around for end in (min, max)))
    _trim(len(held) // _WRITING)  # the register and the record of a large fleet take memory
    removals = Plan(tuple(step for step in plan.steps if step.action is Action.REMOVED), plan.state)
    others = replace(plan, steps=tuple(step for step in plan.steps if step.action is not Action.REMOVED))
    common, folder = store.stage_common(places), records[-1].folder
    staged: list[Exchange] = []
    try:
        store.change(guards)  # before the first secret is written
        with reported(folder), open_at(folder) as opened:  # it tells what could not be written since then
            staged += (*workers.stage(store, others.changes(), meanwhile), *common)
            staged += store.stage((*removals.changes(), *records))
            sync_file_system(opened)
    except BaseException:
        store.discard((*staged, *common))
        raise
    return staged


def next_answer(
    call: Call, inputs: Inputs, plan: Plan, report: Report, console: Console
) -> tuple[Session, Answer] | None:
    """Return the workspace as a command leaves it, and what the command prints then, or None if something is in doubt.

    Args:
        call: the command.
        inputs: the workspace before it.
        plan: what it does.
        report: what it reports.
        console: where the report is shown.
    """
    expected = next_report(plan, report)
    if expected is None or not is_recordable(call, str(inputs.workspace.root)):
        return None
    # Profile, authorities and record as they are after the plan; the enclaves of a fleet would take memory.
    workspace = inputs.workspace
    changed = [item for space in (workspace.profile, workspace.public) for item in plan.overlay(f"{space}/")]
    session = replace(inputs, tree=inputs.tree.overlaid(changed), state=plan.state).session()
    settled = all(step.action is Action.UNCHANGED for step in expected.steps) and all(
        each.code in _TOLD_ANYWAY for each in expected.diagnostics
    )
    is_certain = not plan.writes() or not expected.diagnostics
    if not settled and not is_certain:
        return None
    answer = Answer(*console.rendered(expected), int(expected.exit_code), settled, is_certain)
    _trim(len(plan.steps) // _WRITING)  # the folders of a large fleet take memory
    return session, answer


def record_answer(
    call: Call, session: Session, sight: Sight, dates: Iterable[datetime], answer: Answer, store: Store
) -> None:
    """Record what a command will print as long as nothing changes.

    Args:
        call: the command, which is recordable.
        session: the workspace as the command left it, and its profile.
        sight: its files.
        dates: dates at which the answer may change, beside those of authorities and in the record.
        answer: what the same command will print.
        store: the writer.
    """
    seen = recorded_files(session)
    if seen is None:
        return
    validities = [authority.certificate.validity for authority in session.profile.authorities]
    ends = (date for each in validities for date in (each.not_before, each.not_after))
    updates = (each.next_update for each in loaded_lists(session).values())
    content = record(call, str(session.workspace.root), sight, seen, (*dates, *ends, *updates), answer)
    if content is not None:
        store.write_hint(name_of(call), content)


def next_report(plan: Plan, report: Report) -> Report | None:
    """Return what a command reports if it is given again, or None if that is not known.

    What has nothing to do does the same again. After one that did something, everything is unchanged, and no workspace
    is new; whether its diagnostics are told again is not known of most.
    """
    if not plan.writes():
        return report
    steps: list[Step] = []
    for step in plan.steps:
        if step.action in {Action.REMOVED, Action.KEPT} or (step.stage == BUILD and not step.package):
            return None  # it is not known how such a step is reported next time
        if step.package:  # what has none is only reported if it is written
            detail = step.detail if step.stage == AUTHORITIES else ""
            steps.append(Step(step.stage, step.package, Action.UNCHANGED, detail=detail))
    return replace(
        report,
        steps=steps,
        diagnostics=[each for each in report.diagnostics if each.code not in _TOLD_ONCE],
        result=dict.fromkeys(report.result, ()),  # nobody gains or loses anything by doing it again
    )
