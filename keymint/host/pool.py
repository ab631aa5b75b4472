# SPDX-License-Identifier: Apache-2.0
"""A pool carries out tasks in processes of this machine, and yields the results in order."""

from __future__ import annotations

import gc
import signal
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import pairwise
from typing import Any, TypeVar

from keymint.errors import process_ended

Task = TypeVar("Task")
Result = TypeVar("Result")

PARTS_FOR_EACH = 4
"""Parts of the work for each process: a part that takes longer than the others delays the end less."""


class Pool:
    """Carries out tasks, in processes that are forked for each call with more than one task.

    Args:
        size: number of tasks that it carries out at a time.
    """

    def __init__(self, size: int) -> None:
        self.size = size

    def parts(self, items: Sequence[Task], least: int) -> list[Sequence[Task]]:
        """Divide work into parts of about equal size, in order.

        Args:
            items: what is to be done.
            least: number of items that are worth a process of their own.
        """
        most = self.size * PARTS_FOR_EACH if self.size > 1 else 1
        return divide(items, max(1, min(most, len(items) // max(1, least))))

    def map(self, work: Callable[[Task], Result], tasks: Iterable[Task]) -> Iterator[Result]:
        """Yield the result of each task, in the order of the tasks.

        Raises:
            KeymintError: the work fails, or a process that carries it out is lost.
        """
        # A forked process has the tasks already: they need not be sent to it.
        tasks = tuple(tasks)
        count = min(self.size, len(tasks))
        if count < 2:  # noqa: PLR2004 - nothing to do at the same time
            yield from map(work, tasks)
            return
        from concurrent.futures import ProcessPoolExecutor  # noqa: PLC0415 - few runs need it
        from concurrent.futures.process import BrokenProcessPool  # noqa: PLC0415
        from multiprocessing import get_context  # noqa: PLC0415

        _inherited.append(lambda at: work(tasks[at]))
        executor = ProcessPoolExecutor(count, get_context("fork"), _begin)
        try:
            yield from executor.map(_numbered, range(len(tasks)))
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
