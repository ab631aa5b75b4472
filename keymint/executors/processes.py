# SPDX-License-Identifier: Apache-2.0
"""The default pool: processes of this machine."""

from __future__ import annotations

import gc
import signal
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context
from typing import Any

from keymint.api.plugin_loader import Plugins
from keymint.errors import process_ended
from keymint.executors.pool import PARTS_FOR_EACH, Result, Task, Work, divide, in_order


class Processes:
    """Implements :class:`keymint.executors.Pool` with processes, forked for each call with more than one task.

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
        """See :meth:`keymint.executors.Pool.parts`."""
        most = self.size * PARTS_FOR_EACH if self.size > 1 else 1
        return divide(items, max(1, min(most, len(items) // max(1, least))))

    def map(self, work: Work[Task, Result], tasks: Iterable[Task]) -> Iterator[Result]:
        """See :meth:`keymint.executors.Pool.map`."""
        # A forked process has the tasks already: they need not be sent to it.
        tasks = tuple(tasks)
        count = min(self.size, len(tasks))
        if count < 2:  # noqa: PLR2004 - nothing to do at the same time
            yield from (work(self._plugins, task) for task in tasks)
            return
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
