# SPDX-License-Identifier: Apache-2.0
"""A pool carries out tasks in processes of this machine, and yields the results in order."""

from __future__ import annotations

import gc
import signal
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any, TypeVar

from keymint.errors import process_ended

if TYPE_CHECKING:
    from multiprocessing.connection import Connection

Task = TypeVar("Task")
Result = TypeVar("Result")

PARTS_FOR_EACH = 4
"""Parts of the work for each process: a part that takes longer than the others delays the end less."""


class Pool:
    """Carries out tasks, in this process and others, which are forked for each call with more than one task.

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
        tasks = tuple(tasks)
        count = min(self.size, len(tasks))
        if count < 2:  # noqa: PLR2004 - nothing to do at the same time
            yield from map(work, tasks)
            return
        from multiprocessing import get_context  # noqa: PLC0415 - few runs need it

        context, pipes = get_context("fork"), []
        for number in range(count - 1):
            here, there = context.Pipe(duplex=False)
            # A forked process has the tasks already: they need not be sent to it.
            context.Process(target=_answer, args=(there, work, tasks[number::count]), daemon=True).start()
            there.close()
            pipes.append(here)
        own = _results(work, tasks[count - 1 :: count])
        try:
            found: list[_Results] = [*(pipe.recv() for pipe in pipes), own]
        except EOFError as lost:
            raise process_ended("executor-lost") from lost
        for at in range(len(tasks)):
            result, error = found[at % count][at // count]
            if error is not None:
                raise error
            yield result


_Results = list[tuple[Any, Exception | None]]
"""Results of tasks, up to the first that failed."""


def _results(work: Callable[[Any], Any], tasks: Iterable[Any]) -> _Results:
    found: _Results = []
    for task in tasks:
        try:
            found.append((work(task), None))
        except Exception as error:  # noqa: BLE001 - raised where the results come together
            return [*found, (None, error)]
    return found


def _answer(pipe: Connection, work: Callable[[Any], Any], tasks: Iterable[Any]) -> None:
    """Carry out tasks in a process of its own; it is left to the one that the user started to end the run."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    gc.freeze()  # a search for cycles among the parent's objects would copy their pages
    pipe.send(_results(work, tasks))


def divide(items: Sequence[Task], number: int) -> list[Sequence[Task]]:
    """Divide items into a number of parts of about equal size, in order."""
    ends = [len(items) * at // number for at in range(number + 1)]
    return [items[first:last] for first, last in pairwise(ends)]
