# SPDX-License-Identifier: Apache-2.0
"""Standard streams that exist and report failed writes, and an orderly end on signals.

Only the command line uses this module; everything else gets its streams from there.
"""

from __future__ import annotations

import contextlib
import io
import os
import signal
import sys
from collections.abc import Iterator
from types import SimpleNamespace
from typing import IO

_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_received: list[int] = []


class StoppedError(BaseException):
    """A signal asks the process to end.

    This is not a KeyboardInterrupt, because libraries handle that one in their own ways.

    Args:
        number: of the signal.
    """

    def __init__(self, number: int) -> None:
        self.number = number
        super().__init__(signal.Signals(number).name)


class OutputError(Exception):
    """A standard stream cannot be written to.

    Args:
        error: the system's error.
    """

    def __init__(self, error: OSError | ValueError) -> None:
        super().__init__(getattr(error, "strerror", None) or str(error))


class Output(io.TextIOBase):
    """A standard stream that reports failed writes, and whether anything was written to it.

    If a reader stops early, e.g. ``head``, the rest of the output is lost, and the run goes on to its end: a file that
    half of a run would have written is worse than a line that nobody reads, and the exit code is that of the run.

    Args:
        stream: the stream; None if the process was started without it.
        required: raise :class:`OutputError` if a write fails; otherwise the output is lost.
    """

    def __init__(self, stream: IO[str] | None, *, required: bool = True) -> None:
        self._stream = stream
        self._required = required
        self.began = False
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # a locale that lacks a character is no reason to fail

    @property
    def encoding(self) -> str:  # type: ignore[override]
        """The encoding of the stream."""
        return getattr(self._stream, "encoding", None) or "utf-8"

    @property
    def buffer(self) -> SimpleNamespace:
        """What takes bytes: click writes completions to it."""
        return SimpleNamespace(write=self.put, flush=self.flush)

    def isatty(self) -> bool:
        """Tell whether the stream is a terminal."""
        return self._stream is not None and self._stream.isatty()

    def writable(self) -> bool:
        """Tell that the stream can be written to."""
        return True

    def write(self, text: str) -> int:
        """Write text.

        Raises:
            OutputError: the stream does not exist, or cannot be written to.
        """
        with self._reported():
            if self._stream is None:
                raise ValueError("it is closed")
            self.began = self.began or bool(text)
            self._stream.write(text)
        return len(text)

    def put(self, content: bytes) -> int:
        """Write bytes unchanged, whatever the encoding of the stream, and return their number.

        Raises:
            OutputError: the stream does not exist, or cannot be written to.
        """
        below = getattr(self._stream, "buffer", None)
        if below is None:
            self.write(content.decode("utf-8", "backslashreplace"))
            return len(content)
        self.flush()
        with self._reported():
            self.began = self.began or bool(content)
            below.write(content)
        return len(content)

    def flush(self) -> None:
        """Flush the stream.

        Raises:
            OutputError: the stream cannot be written to.
        """
        with self._reported():
            if self._stream is not None:
                self._stream.flush()

    def close(self) -> None:
        """Do nothing: the stream belongs to the process, and may already be closed."""

    def give_up(self) -> None:
        """Discard unwritten output, so that it is not retried when the process ends."""
        with contextlib.suppress(AttributeError, OSError, ValueError):
            nowhere = os.open(os.devnull, os.O_WRONLY | os.O_CLOEXEC)
            os.dup2(nowhere, self._stream.fileno())  # type: ignore[union-attr]
            os.close(nowhere)

    @contextlib.contextmanager
    def _reported(self) -> Iterator[None]:
        try:
            yield
        except (OSError, ValueError) as error:
            if self._required and not isinstance(error, ConnectionError):
                raise OutputError(error) from error
            self.give_up()


def open_missing_streams() -> None:
    """Open missing standard streams, so that no other file becomes standard output."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # the lowest number that is free is this one


def stop_on_signals() -> None:
    """Raise :class:`StoppedError` in the main thread on SIGINT and SIGTERM.

    A second signal ends the process at once.
    """
    sys.unraisablehook = _say_unraisable
    for number in _SIGNALS:
        if signal.getsignal(number) is not signal.SIG_IGN:  # as under nohup, or in the background of a script
            signal.signal(number, _stop)


def hold_signals() -> None:
    """Block signals: an interrupted import leaves modules incomplete, and fails in odd ways."""
    signal.pthread_sigmask(signal.SIG_BLOCK, _SIGNALS)


def release_signals() -> None:
    """Unblock signals, including pending ones."""
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _SIGNALS)


def settle() -> None:
    """Block signals until the process ends, if this module handles them: all work is done and reported."""
    if signal.getsignal(signal.SIGTERM) is _stop or _received:
        hold_signals()


@contextlib.contextmanager
def held_signals() -> Iterator[None]:
    """Block signals for a short time; see :func:`hold_signals`."""
    hold_signals()
    try:
        yield
    finally:
        release_signals()


def received_signal() -> int:
    """Return the number of the signal that asked the process to end, or 0."""
    return _received[0] if _received else 0


def _stop(number: int, _frame: object) -> None:
    _received.append(number)
    for each in _SIGNALS:
        signal.signal(each, signal.SIG_DFL)
    raise StoppedError(number)


def _say_unraisable(unraisable: sys.UnraisableHookArgs) -> None:
    # A signal that arrives in a callback of C code, or in a finaliser, cannot be raised there.
    if not isinstance(unraisable.exc_value, StoppedError):
        sys.__unraisablehook__(unraisable)
