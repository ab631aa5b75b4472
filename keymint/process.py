"""What a process owes the system: streams that are there, writes whose failure is reported, and an orderly end.

Only the command line uses it; everything below gets its streams from there.
"""

from __future__ import annotations

import contextlib
import io
import os
import signal
import sys
from collections.abc import Iterator
from typing import IO, TYPE_CHECKING

if TYPE_CHECKING:
    from typing_extensions import Buffer

_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_received: list[int] = []


class StoppedError(BaseException):
    """A signal asks the process to end.

    It is no KeyboardInterrupt: libraries handle that one, each in its own way.

    Args:
        number: of the signal.
    """

    def __init__(self, number: int) -> None:
        self.number = number
        super().__init__(signal.Signals(number).name)


class OutputError(Exception):
    """A standard stream takes no more.

    Args:
        error: what the system said.
    """

    def __init__(self, error: OSError | ValueError) -> None:
        self.broken_pipe = isinstance(error, BrokenPipeError)
        super().__init__(getattr(error, "strerror", None) or str(error))


class Output(io.TextIOBase):
    """A standard stream that tells when it fails, and whether anything was written to it.

    Args:
        stream: the stream; None when the process was started without it.
        required: a failure to write is an :class:`OutputError`; otherwise what is written is lost.
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
    def buffer(self) -> _Bytes:
        """What takes bytes in place of text."""
        return _Bytes(self)

    def isatty(self) -> bool:
        """Tell whether the stream is a terminal."""
        return self._stream is not None and self._stream.isatty()

    def writable(self) -> bool:
        """Tell that the stream can be written to."""
        return True

    def write(self, text: str) -> int:
        """Write text.

        Raises:
            OutputError: the stream is not there, or takes no more.
        """
        with self._told():
            if self._stream is None:
                raise ValueError("it is closed")
            self.began = self.began or bool(text)
            self._stream.write(text)
        return len(text)

    def put(self, content: bytes) -> None:
        """Write a document byte for byte, whatever the encoding of the stream.

        Raises:
            OutputError: the stream is not there, or takes no more.
        """
        below = getattr(self._stream, "buffer", None)
        if below is None:
            self.write(content.decode("utf-8", "backslashreplace"))
            return
        self.flush()
        with self._told():
            self.began = self.began or bool(content)
            below.write(content)

    def flush(self) -> None:
        """Hand on what was written.

        Raises:
            OutputError: the stream takes no more.
        """
        with self._told():
            if self._stream is not None:
                self._stream.flush()

    def close(self) -> None:
        """Leave the stream as it is: it is the process's, and may be closed already when this wrapper goes."""

    def give_up(self) -> None:
        """Let what could not be written go, so that nothing tries again when the process ends."""
        with contextlib.suppress(AttributeError, OSError, ValueError):
            nowhere = os.open(os.devnull, os.O_WRONLY | os.O_CLOEXEC)
            os.dup2(nowhere, self._stream.fileno())  # type: ignore[union-attr]
            os.close(nowhere)

    @contextlib.contextmanager
    def _told(self) -> Iterator[None]:
        try:
            yield
        except (OSError, ValueError) as error:
            if self._required:
                raise OutputError(error) from error
            self.give_up()


class _Bytes(io.RawIOBase):
    """The same stream, for bytes: libraries look for one."""

    def __init__(self, output: Output) -> None:
        self._output = output

    def writable(self) -> bool:
        return True

    def write(self, content: Buffer, /) -> int:
        data = bytes(content)
        self._output.put(data)
        return len(data)

    def flush(self) -> None:
        self._output.flush()

    def close(self) -> None:
        """Leave the stream as it is."""


def open_missing_streams() -> None:
    """Open what the process was started without, so that no file of ours becomes its standard output."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # the lowest number that is free is this one


def stop_on_signals() -> None:
    """End on SIGINT and on SIGTERM by a :class:`StoppedError`, wherever the main thread is then.

    A second signal ends the process at once: whoever sends it has waited long enough for the first.
    """
    sys.unraisablehook = _say_unraisable
    for number in _SIGNALS:
        if signal.getsignal(number) is not signal.SIG_IGN:  # as under nohup, or in the background of a script
            signal.signal(number, _stop)


def hold_signals() -> None:
    """Let signals wait: an import that is interrupted leaves modules half made, and fails in odd ways."""
    signal.pthread_sigmask(signal.SIG_BLOCK, _SIGNALS)


def release_signals() -> None:
    """Take signals again, those that wait included."""
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _SIGNALS)


def settle() -> None:
    """Let signals wait for good, if they were ours to handle: the work is done and said, and what remains is quick."""
    if signal.getsignal(signal.SIGTERM) is _stop or _received:
        hold_signals()


@contextlib.contextmanager
def held_signals() -> Iterator[None]:
    """Let signals wait for a short while; see :func:`hold_signals`."""
    hold_signals()
    try:
        yield
    finally:
        release_signals()


def received() -> int:
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
