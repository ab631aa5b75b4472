# SPDX-License-Identifier: Apache-2.0
"""Pools: carry out tasks and yield the results in order."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Protocol, TypeVar

from keymint.api.plugin_loader import Plugins

if TYPE_CHECKING:
    from concurrent.futures import Future  # slow to import, and only some runs need a pool

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
