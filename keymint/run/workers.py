# SPDX-License-Identifier: Apache-2.0
"""Processes that plan packages, each a part of them, and keep the bytes that they planned until these are written.

They are forked, so that they begin with everything that was loaded. They send plans without bytes, so no key leaves
them. Nothing is written until the plans of all packages have arrived and are right; then each process stages its part,
and the parent commits all parts together.
"""

from __future__ import annotations

import contextlib
import gc
import io
import itertools
import os
import pickle
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import fields, is_dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar, cast

from keymint.errors import KeymintError, process_ended
from keymint.host.streams_and_signals import held_signals
from keymint.stages.work import PackagePlan, PackageStage, session_after
from keymint.store.changes import Action, FolderChange
from keymint.store.staged import Exchange
from keymint.store.store import Store
from keymint.workspace.package_build_types import may_share
from keymint.workspace.session import Session
from keymint.workspace.workspace import Workspace

if TYPE_CHECKING:
    from multiprocessing.connection import Connection

MIN_PACKAGES = 64
"""Packages from which on processes are worth their start."""

_DONE, _REFUSED, _CRASHED = "done", "refused", "crashed"
"""Kinds of answers of a process."""
_T = TypeVar("_T")
_Stages = Sequence[Callable[[Session], PackageStage[Any]]]


class Workers:
    """The processes of one run; without any, the caller's process plans everything.

    Args:
        count: the most processes to start.
        store: opens the store of a workspace, which the processes stage with.
    """

    def __init__(self, count: int, store: Callable[[Workspace], Store]) -> None:
        self._count = count
        self._store = store
        self._processes: list[Any] = []
        self._pipes: list[Connection] = []

    def start(self, session: Session, names: Sequence[str], stages: _Stages) -> None:
        """Let processes plan some packages, if that is worth it; they begin at once.

        Args:
            session: the workspace and its profile.
            names: the packages.
            stages: the stages, in their order.
        """
        parts = _parts(names, self._count)
        # A thread of this process would not be there in a forked one, but the locks that it holds would.
        if len(names) < MIN_PACKAGES or len(parts) == 1 or threading.active_count() > 1 or not hasattr(os, "fork"):
            return
        if may_share(session, names):
            return
        # A module of a token must not be used in a forked process (PKCS #11, C_Initialize), and one session is enough.
        if any(authority.certificate.key.uri for authority in session.profile.authorities):
            return
        import multiprocessing  # noqa: PLC0415 - takes 20 ms, and few runs need it

        # What the first package needs is imported, compiled and proven once for all processes.
        with contextlib.suppress(KeymintError):
            for _ in _plan(lambda *_answer: None, session, names[:1], stages):
                pass
        context = multiprocessing.get_context("fork")
        for part in parts:
            here, there = context.Pipe()
            process = context.Process(
                target=_work, args=(there, [*self._pipes, here], session, part, stages, self._store)
            )
            with held_signals():  # the process keeps them blocked: this one decides
                process.start()
            there.close()
            self._processes.append(process)
            self._pipes.append(here)

    def planned(self, stage: PackageStage[_T], names: Sequence[str]) -> list[_T]:
        """Return what a stage plans for each package.

        Raises:
            KeymintError: the stage cannot plan at all, or a process ended before it had planned its part.
        """
        if not self._pipes:
            return [stage.package(name) for name in names]
        return [each for pipe in self._pipes for each in _answer(pipe)]

    def stage(self, store: Store) -> list[Exchange]:
        """Let the processes stage what they planned, and return it in the order of stages.

        Args:
            store: discards what some staged if others fail.

        Raises:
            KeymintError: the system refuses a write; what others staged is discarded.
        """
        for pipe in self._pipes:
            with contextlib.suppress(OSError):  # the process ended, which its missing answer tells
                pipe.send(None)
        by_process: list[list[Sequence[Exchange]]] = []
        errors: list[KeymintError] = []
        for pipe in self._pipes:
            try:
                by_process.append(_answer(pipe))
            except KeymintError as error:
                errors.append(error)
        if errors:
            for staged in itertools.chain(*by_process):
                store.discard(staged)
            raise errors[0]
        return [each for of_stage in zip(*by_process, strict=True) for staged in of_stage for each in staged]

    def give_up(self) -> None:
        """End all processes, and start no others: the caller's process plans everything."""
        self.close()
        self._count = 1

    def close(self) -> None:
        """End all processes; what they did not stage is lost."""
        for pipe in self._pipes:
            pipe.close()
        for process in self._processes:
            process.kill()
            process.join()
        self._processes.clear()
        self._pipes.clear()


def _parts(names: Sequence[str], count: int) -> list[list[str]]:
    """Divide sorted names into parts of similar size; what lies in one folder stays together, below a common one."""
    common = os.path.commonpath([name.rpartition("/")[0] for name in names]) if names else ""
    level = common.count("/") + 1 if common else 0
    parts: list[list[str]] = [[]]
    for _, group in itertools.groupby(names, key=lambda name: name.split("/")[level]):
        if len(parts) < count and len(parts[-1]) * count >= len(names):
            parts.append([])
        parts[-1] += group
    return parts


class _Pickler(pickle.Pickler):
    """Pickles frozen data by the arguments of its constructor, which is faster than field by field."""

    _fields: ClassVar[dict[type, list[str]]] = {}

    def reducer_override(self, given: object) -> Any:
        kind = type(given)
        if kind not in self._fields:
            self._fields[kind] = [each.name for each in fields(kind) if each.init] if is_dataclass(kind) else []
        names = self._fields[kind]
        return (kind, tuple([getattr(given, name) for name in names])) if names else NotImplemented


def _send(pipe: Connection, *answer: object) -> None:
    content = io.BytesIO()
    _Pickler(content, pickle.HIGHEST_PROTOCOL).dump(answer)
    pipe.send_bytes(content.getbuffer())


def _answer(pipe: Connection) -> list[Any]:
    try:
        kind, *answer = pickle.loads(pipe.recv_bytes())  # noqa: S301 - from a process that this one forked
    except (EOFError, OSError):
        raise process_ended("worker-ended") from None
    if kind == _REFUSED:
        raise KeymintError.of(*answer)
    if kind == _CRASHED:
        message, trace = answer
        error = RuntimeError(message)
        error.add_note(trace)
        raise error
    return cast("list[Any]", answer[0])


def _work(
    pipe: Connection,
    inherited: Sequence[Connection],
    session: Session,
    names: Sequence[str],
    stages: _Stages,
    store: Callable[[Workspace], Store],
) -> None:
    """Plan packages stage by stage; stage them when the parent says so. This runs in a process of its own."""
    gc.freeze()  # a search for cycles among the parent's objects would copy their pages
    for each in inherited:  # otherwise this process would not see that the parent ended
        each.close()
    with contextlib.suppress(EOFError, OSError):
        try:
            changes = list(_plan(partial(_send, pipe), session, names, stages))
            pipe.recv()
            opened = store(session.workspace)
            _send(pipe, _DONE, [opened.stage(of_stage) for of_stage in changes])
        except KeymintError as error:
            _send(pipe, _REFUSED, error.diagnostics, error.exit_code)
        except Exception as error:  # noqa: BLE001 - the parent reports it
            import traceback  # noqa: PLC0415 - few runs need it

            _send(pipe, _CRASHED, f"{type(error).__name__}: {error}", traceback.format_exc())


def _plan(
    send: Callable[..., None], session: Session, names: Sequence[str], stages: _Stages
) -> Iterator[list[FolderChange]]:
    """Plan packages, send the plans of each stage without their bytes, and yield the changes of each stage."""
    for start in stages:
        stage = start(session)
        planned = [stage.package(name) for name in names]
        plans = [each for each in planned if isinstance(each, PackagePlan)]
        send(_DONE, [_without_bytes(each) for each in plans] or planned)
        if any(each.errors for each in plans):
            return
        session = session_after(session, stage.NAME, plans)
        names = [each.name for each in plans if _is_installed(each)]
        yield [change for each in plans if each.step for change in each.step.changes]


def _is_installed(plan: PackagePlan) -> bool:
    return not plan.withdrawn and (plan.step is None or plan.step.action is not Action.KEPT)


def _without_bytes(plan: PackagePlan) -> PackagePlan:
    if plan.step is None or not plan.step.changes:
        return plan
    return replace(plan, step=replace(plan.step, changes=tuple(each.held_elsewhere() for each in plan.step.changes)))
