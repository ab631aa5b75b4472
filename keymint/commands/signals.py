"""Signals that stop an observation early and keep its result."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from keymint.errors import ExitCode

_EXIT_CODES = {signal.SIGINT: ExitCode.INTERRUPTED, signal.SIGTERM: ExitCode.TERMINATED}


class Ending:
    """Whether a signal requested the end.

    Attributes:
        exit_code: the exit code of the first signal, or None if there was none.
    """

    def __init__(self) -> None:
        self.exit_code: ExitCode | None = None


@contextmanager
def ended_by_signals() -> Iterator[Ending]:
    """Record the first SIGINT or SIGTERM within the block; a second one has its usual effect."""
    ending = Ending()
    if threading.current_thread() is not threading.main_thread():  # only the main thread can set handlers
        yield ending
        return
    before = {number: signal.getsignal(number) for number in _EXIT_CODES}

    def restore() -> None:
        for number, handler in before.items():
            signal.signal(number, handler)

    def note(number: int, _frame: FrameType | None) -> None:
        ending.exit_code = _EXIT_CODES[signal.Signals(number)]
        restore()

    for number, handler in before.items():
        if handler is not signal.SIG_IGN:  # nohup and background jobs of shells ignore it
            signal.signal(number, note)
    try:
        yield ending
    finally:
        restore()
