# SPDX-License-Identifier: Apache-2.0
"""Software of a vendor: that it is missing, a process of it that answers commands, and transports that ask it."""

from __future__ import annotations

import os
import select
import subprocess
import tempfile
import time
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import IO, cast

from keymint.api.transports import Availability, Environment, Transport

GRACE_SECONDS = 30.0
"""How long an answer may take beyond the time of its command before the process counts as hung."""


class MissingVendorError(Exception):
    """The software of a vendor is not installed, or is too old.

    Args:
        vendor: the vendor's name, for people.
        reason: what is missing.
        help_: how to install it.
    """

    def __init__(self, vendor: str, reason: str, help_: str) -> None:
        self.reason = reason
        self.help = help_
        super().__init__(f"{vendor}: {reason}; {help_}")


class ProcessFailedError(Exception):
    """The process hangs, has died, or does not know a command: not a decision of the vendor."""


class ProcessDiedError(ProcessFailedError):
    """The process has died."""


class CommandProcess:
    """A process that answers each line that it reads with a line; :meth:`reap` always ends it.

    Args:
        words: the program and its arguments; no word is from outside.
        environment: its variables.
        noun: what it is, in messages.
    """

    def __init__(self, words: Sequence[str], environment: Mapping[str, str], noun: str) -> None:
        self._noun = noun
        self._errors: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115 - lives as long as the process
        try:
            self._process = subprocess.Popen(  # noqa: S603 - no shell
                words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self._errors, env=dict(environment)
            )
        except OSError:
            self._errors.close()
            raise
        self._input, self._output = cast("IO[bytes]", self._process.stdin), cast("IO[bytes]", self._process.stdout)
        self._pending = b""

    def _send(self, command: str, lines: bytes) -> None:
        try:
            self._input.write(lines)
            self._input.flush()
        except BrokenPipeError:
            raise self._died(command) from None

    def _line(self, command: str, seconds: float) -> bytes:
        """Return the next line of the process, which may take so many seconds for its command."""
        deadline = time.monotonic() + seconds + GRACE_SECONDS
        while b"\n" not in self._pending:
            left = deadline - time.monotonic()
            if left <= 0 or not select.select([self._output], [], [], left)[0]:
                self.reap()
                raise ProcessFailedError(f"{self._noun} did not answer the command {command!r} in time")
            chunk = os.read(self._output.fileno(), 1 << 20)
            if not chunk:
                raise self._died(command)
            self._pending += chunk
        line, self._pending = self._pending.split(b"\n", 1)
        return line

    def _died(self, command: str) -> Exception:
        code = self._process.wait(timeout=GRACE_SECONDS)
        self._errors.seek(0)
        said = self._errors.read().decode(errors="replace").strip()
        return ProcessDiedError(f"{self._noun} died at {command!r} with exit code {code}: {said}")

    def reap(self) -> None:
        """Kill the process and close its streams; may be called again."""
        self._process.kill()
        self._process.wait()
        for stream in (self._input, self._output, self._errors):
            try:
                stream.close()
            except BrokenPipeError:
                continue


class VendorTransport(Transport):
    """What transports that ask the software of a vendor have in common.

    Args:
        environment: the cache, and the environment variables of processes.
    """

    def __init__(self, environment: Environment) -> None:
        self._environment = environment

    def usable(self) -> Availability:
        """Return whether it can be used here; determined once."""
        return self._usable

    @cached_property
    def _usable(self) -> Availability:
        try:
            return self._installed()
        except MissingVendorError as error:
            return Availability(usable=False, reason=error.reason, help=error.help)

    @abstractmethod
    def _installed(self) -> Availability:
        """Look for the vendor's software.

        Raises:
            MissingVendorError: it is not there, or too old.
        """
