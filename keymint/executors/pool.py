# SPDX-License-Identifier: Apache-2.0
"""Pools: carry out tasks and yield the results in order; the default is processes of this machine."""

from __future__ import annotations

import signal
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from itertools import pairwise
from multiprocessing import get_context
from typing import Any, Protocol, TypeVar

from keymint.errors import process_ended
from keymint.plugins import Plugins

Task = TypeVar("Task")
Result = TypeVar("Result")
Submitted = TypeVar("Submitted")
Work = Callable[[Plugins, Task], Result]
"""A function of a module. The class of the result is its annotation."""

PARTS_FOR_EACH = 4
"""Parts of the work for each process: a part that takes longer than the others delays the end less."""


class Pool(Protocol):
    """Carries out tasks.

    Attributes:
        size: number of tasks that it carries out at a time.
        shares_memory: its processes have the memory and the files of this one; else tasks are sent to them.
        trusted: what its processes answer is as good as what this process finds.
    """

    size: int
    shares_memory: bool
    trusted: bool

    def parts(self, items: Sequence[Task], least: int) -> list[Sequence[Task]]:
        """Divide work into parts of about equal size, in order.

        Args:
            items: what is to be done.
            least: number of items that are worth a process of their own.
        """

    def map(self, work: Work[Task, Result], tasks: Iterable[Task]) -> Iterator[Result]:
        """Yield the result of each task, in the order of the tasks.

        Raises:
            KeymintError: the work fails, or a process that carries it out is lost.
        """


def divided(items: Sequence[Task], number: int) -> list[Sequence[Task]]:
    """Divide items into a number of parts of about equal size, in order."""
    ends = [len(items) * at // number for at in range(number + 1)]
    return [items[first:last] for first, last in pairwise(ends)]


def in_order(
    submit: Callable[[Submitted], Future[Result]], tasks: Iterable[Submitted], most: int
) -> Iterator[Future[Result]]:
    """Yield a future for each task, in the order of the tasks; at most so many are submitted and not yet yielded."""
    waiting: deque[Future[Result]] = deque()
    for task in tasks:
        waiting.append(submit(task))
        if len(waiting) >= most:
            yield waiting.popleft()
    yield from waiting


class Processes:
    """Implements :class:`Pool` with processes that are forked for each call, if there is more than one task.

    Args:
        plugins: the installed plugins.
        size: number of processes.
    """

    shares_memory = True
    trusted = True

    def __init__(self, plugins: Plugins, size: int) -> None:
        self._plugins = plugins
        self.size = size

    def parts(self, items: Sequence[Task], least: int) -> list[Sequence[Task]]:
        """See :meth:`Pool.parts`."""
        most = self.size * PARTS_FOR_EACH if self.size > 1 else 1
        return divided(items, max(1, min(most, len(items) // max(1, least))))

    def map(self, work: Work[Task, Result], tasks: Iterable[Task]) -> Iterator[Result]:
        """See :meth:`Pool.map`."""
        # A forked process has the tasks already: they need not be sent to it.
        tasks = tuple(tasks)
        count = min(self.size, len(tasks))
        if count < 2:  # noqa: PLR2004 - nothing to do at the same time
            yield from (work(self._plugins, task) for task in tasks)
            return
        _inherited.append(lambda at: work(self._plugins, tasks[at]))
        executor = ProcessPoolExecutor(count, get_context("fork"), _ignore_signals)
        try:
            for future in in_order(lambda at: executor.submit(_numbered, at), range(len(tasks)), 4 * count):
                yield future.result()
        except BrokenProcessPool as error:
            raise process_ended("executor-lost") from error
        finally:
            executor.shutdown(cancel_futures=True)
            _inherited.pop()


_inherited: list[Callable[[int], Any]] = []
"""What forked processes carry out: a function of the number of a task."""


def _numbered(at: int) -> Any:
    return _inherited[-1](at)


def _ignore_signals() -> None:
    """Leave it to the process that the user started to end the run; it ends its processes too."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
