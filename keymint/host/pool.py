# SPDX-License-Identifier: Apache-2.0
"""A pool carries out tasks in processes of this machine, and yields the results in order."""

from __future__ import annotations

import gc
import os
import signal
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import chain, pairwise
from typing import TYPE_CHECKING, Any, TypeVar

from keymint.errors import process_ended

if TYPE_CHECKING:
    from multiprocessing.connection import Connection

Task = TypeVar("Task")
Result = TypeVar("Result")

PARTS_FOR_EACH = 16
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
        """Yield the result of each task, in the order of the tasks. This process carries out the last one first.

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
        left, given = os.pipe()  # numbers of tasks: whoever is ready takes the next one
        os.write(given, b"".join(number.to_bytes(2) for number in range(len(tasks) - 1)))
        os.close(given)
        for _ in range(count - 1):
            here, there = context.Pipe(duplex=False)
            # A forked process has the tasks already: they need not be sent to it.
            context.Process(target=_answer, args=(there, work, tasks, left), daemon=True).start()
            there.close()
            pipes.append(here)
        found = _results(work, tasks, left, [len(tasks) - 1])
        os.close(left)
        try:
            for pipe in pipes:
                found |= pipe.recv()
        except EOFError as lost:
            raise process_ended("executor-lost") from lost
        for number in range(len(tasks)):  # what nobody took comes after one that failed
            result, error = found[number]
            if error is not None:
                raise error
            yield result


_Results = dict[int, tuple[Any, Exception | None]]
"""Results of tasks by number, up to the first that failed."""


def _results(work: Callable[[Any], Any], tasks: Sequence[Any], left: int, first: Iterable[int] = ()) -> _Results:
    """Return the results of some tasks, and of those that this process takes."""
    found: _Results = {}
    taken = map(int.from_bytes, iter(lambda: os.read(left, 2), b""))
    for number in chain(first, taken):
        try:
            found[number] = work(tasks[number]), None
        except Exception as error:  # noqa: BLE001 - raised where the results come together
            found[number] = None, error
            break
    return found


def _answer(pipe: Connection, work: Callable[[Any], Any], tasks: Sequence[Any], left: int) -> None:
    """Carry out tasks in a process of its own; it is left to the one that the user started to end the run."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    gc.freeze()  # a search for cycles among the parent's objects would copy their pages
    pipe.send(_results(work, tasks, left))


def divide(items: Sequence[Task], number: int) -> list[Sequence[Task]]:
    """Divide items into a number of parts of about equal size, in order."""
    ends = [len(items) * at // number for at in range(number + 1)]
    return [items[first:last] for first, last in pairwise(ends)]
