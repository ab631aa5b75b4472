# SPDX-License-Identifier: Apache-2.0
"""Forked processes, and a pool of them: it carries out tasks, and yields the results in order."""

from __future__ import annotations

import contextlib
import gc
import os
import signal
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from itertools import chain, pairwise
from typing import Any, BinaryIO, TypeVar

from keymint.api import lazy
from keymint.errors import process_ended
from keymint.host.streams_and_signals import held_signals

_dumps, _loads = lazy("pickle:dumps"), lazy("pickle:loads")  # a run in one process needs none of these
Task = TypeVar("Task")
Result = TypeVar("Result")

_SIZE = 8
"""Bytes before an answer with its length."""
PARTS_FOR_EACH = 16
"""Parts of the work for each process: a part that takes longer than the others delays the end less."""


class Forked:
    """A process that was forked from this one, with all that is in its memory, and does one thing.

    Signals do not reach it: it is left to the process that the user started to end the run.

    Args:
        work: what it does: it is given a pipe that :meth:`tell` writes to, and one to :func:`send` answers.
        others: processes that were forked before: it must not hold their pipes, or they would not see this one's end.
            It is added to them before a signal can end the run: who ends them ends it as well.

    Raises:
        OSError: the system has no room for another process, as in a container with few.
    """

    def __init__(self, work: Callable[[BinaryIO, BinaryIO], object], others: list[Forked]) -> None:
        told, tell = os.pipe()
        answers, sent = os.pipe()
        self._told, self._answers = os.fdopen(tell, "wb"), os.fdopen(answers, "rb")
        with held_signals():  # the process keeps them blocked
            try:
                self.pid = os.fork()
            except OSError:
                self._close()
                os.close(told)
                os.close(sent)
                raise
            if not self.pid:
                try:
                    gc.freeze()  # a search for cycles among the parent's objects would copy their pages
                    for each in (self, *others):
                        each._close()  # noqa: SLF001
                    work(os.fdopen(told, "rb"), os.fdopen(sent, "wb"))
                finally:
                    os._exit(0)
            os.close(told)
            os.close(sent)
            others.append(self)

    def tell(self, value: object) -> None:
        """Send a value to the process, which waits for it."""
        with contextlib.suppress(OSError):  # it ended, which its missing answer tells
            send(self._told, _dumps(value))

    def receive(self) -> Any:
        """Return the next answer; raises as :func:`receive`."""
        return receive(self._answers)

    def end(self) -> None:
        """End the process, whatever it does."""
        self._close()
        with contextlib.suppress(ProcessLookupError, ChildProcessError):  # where SIGCHLD is ignored, it may be gone
            os.kill(self.pid, signal.SIGKILL)
            os.waitpid(self.pid, 0)

    def _close(self) -> None:
        with contextlib.suppress(OSError):  # the process ended before it read all
            self._told.close()
        self._answers.close()


def send(pipe: BinaryIO, pickled: bytes) -> None:
    """Send what was pickled to the process that calls :func:`receive`."""
    pipe.write(len(pickled).to_bytes(_SIZE))
    pipe.write(pickled)
    pipe.flush()


def receive(pipe: BinaryIO) -> Any:
    """Return the next value that was sent.

    Raises:
        EOFError: the other process ended.
    """
    size = int.from_bytes(pipe.read(_SIZE))
    if not size or len(pickled := pipe.read(size)) < size:
        raise EOFError
    return _loads(pickled)


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
        left, given = os.pipe()  # numbers of tasks: whoever is ready takes the next one
        os.write(given, b"".join(number.to_bytes(2) for number in range(len(tasks) - 1)))
        os.close(given)
        others: list[Forked] = []
        try:
            with contextlib.suppress(OSError):  # then this process and those that are there do all
                for _ in range(count - 1):
                    # A forked process has the tasks already: they need not be sent to it.
                    Forked(partial(_answer, work, tasks, left), others)
            found = _results(work, tasks, left, [len(tasks) - 1])
            for each in others:
                found |= each.receive()
        except EOFError as lost:
            raise process_ended("executor-lost") from lost
        finally:
            os.close(left)
            for each in others:
                each.end()
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


def _answer(work: Callable[[Any], Any], tasks: Sequence[Any], left: int, _: BinaryIO, pipe: BinaryIO) -> None:
    """Carry out tasks in a process of its own."""
    send(pipe, _dumps(_results(work, tasks, left)))


def divide(items: Sequence[Task], number: int) -> list[Sequence[Task]]:
    """Divide items into a number of parts of about equal size, in order."""
    ends = [len(items) * at // number for at in range(number + 1)]
    return [items[first:last] for first, last in pairwise(ends)]
