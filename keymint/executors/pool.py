# SPDX-License-Identifier: Apache-2.0
"""A pool carries out tasks and yields the results in order, in processes of this machine unless it is another kind."""

from __future__ import annotations

import gc
import signal
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any, TypeVar

from keymint.api.plugin_loader import Plugins
from keymint.errors import process_ended

if TYPE_CHECKING:
    from concurrent.futures import Future  # slow to import, and only some runs need it

Task = TypeVar("Task")
Result = TypeVar("Result")
Submitted = TypeVar("Submitted")
Work = Callable[[Plugins, Task], Result]
"""A function of a module. The class of the result is its annotation."""

PARTS_FOR_EACH = 4
"""Parts of the work for each process: a part that takes longer than the others delays the end less."""


class Pool:
    """Carries out tasks, in processes that are forked for each call with more than one task.

    Args:
        plugins: the installed plugins.
        size: number of tasks that it carries out at a time.

    Attributes:
        shares_memory: its processes have the memory and the files of this one; else tasks are sent to them.
        trusted: what its processes answer is as good as what this process finds.
    """

    shares_memory = True
    trusted = True

    def __init__(self, plugins: Plugins, size: int) -> None:
        self._plugins = plugins
        self.size = size

    def parts(self, items: Sequence[Task], least: int) -> list[Sequence[Task]]:
        """Divide work into parts of about equal size, in order; a user who named a cluster wants all of it there.

        Args:
            items: what is to be done.
            least: number of items that are worth a process of their own.
        """
        most = self.size * PARTS_FOR_EACH if self.size > 1 or not self.shares_memory else 1
        worth = len(items) // max(1, least) if self.shares_memory else len(items)
        return divide(items, max(1, min(most, worth)))

    def map(self, work: Work[Task, Result], tasks: Iterable[Task]) -> Iterator[Result]:
        """Yield the result of each task, in the order of the tasks.

        Raises:
            KeymintError: the work fails, or a process that carries it out is lost.
        """
        # A forked process has the tasks already: they need not be sent to it.
        tasks = tuple(tasks)
        count = min(self.size, len(tasks))
        if count < 2:  # noqa: PLR2004 - nothing to do at the same time
            yield from (work(self._plugins, task) for task in tasks)
            return
        from concurrent.futures import ProcessPoolExecutor  # noqa: PLC0415 - few runs need it
        from concurrent.futures.process import BrokenProcessPool  # noqa: PLC0415
        from multiprocessing import get_context  # noqa: PLC0415

        _inherited.append(lambda at: work(self._plugins, tasks[at]))
        executor = ProcessPoolExecutor(count, get_context("fork"), _begin)
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


def _begin() -> None:
    """Leave it to the process that the user started to end the run; it ends its processes too."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    gc.freeze()  # a search for cycles among the parent's objects would copy their pages


def divide(items: Sequence[Task], number: int) -> list[Sequence[Task]]:
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
