# SPDX-License-Identifier: Apache-2.0
"""Processes with real Zenoh sessions, routers among them; :mod:`session_program` lists their commands.

They need Zenoh's library for Python: a wheel with access control, TLS, and routers.
"""

from __future__ import annotations

import importlib.metadata
import importlib.util
import json
import sys
import tempfile
import time
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Self

from keymint.host.vendor_process import GRACE_SECONDS, CommandProcess, MissingVendorError, ProcessFailedError
from keymint_ros2_zenoh.vendors import access_log
from keymint_ros2_zenoh.vendors.access_log import LoggedDecision

DISTRIBUTION = "eclipse-zenoh"
OLDEST = (1, 6)
"""Before 1.6.0 one of several matching subjects decided, in the order of a hash table."""
_INHERITED = ("PATH", "LD_LIBRARY_PATH", "PYTHONPATH")


class ZenohError(Exception):
    """The library refuses a command: a configuration, a session, a declaration."""


class ZenohSystem(ExitStack):
    """Processes of real Zenoh with a private temporary folder; both end with the context.

    Args:
        variables: environment variables; the processes inherit those that find programs and libraries.

    Attributes:
        PROGRAM: the program of the processes.
    """

    PROGRAM = Path(__file__).with_name("session_program.py")

    def __init__(self, variables: Mapping[str, str]) -> None:
        super().__init__()
        self._variables = {name: variables[name] for name in _INHERITED if name in variables}
        self._folder = Path()
        self._started = 0

    def __enter__(self) -> Self:
        self._folder = Path(self.enter_context(tempfile.TemporaryDirectory(prefix="keymint-zenoh-")))
        return self

    def start(self, *, log: str = "error") -> ZenohProcess:
        """Start a process without sessions.

        Args:
            log: what the library logs, as in ``RUST_LOG``; :data:`access_log.FILTER` for decisions.
        """
        self._started += 1
        file = self._folder / f"log{self._started}"
        process = ZenohProcess(self.PROGRAM, file, {**self._variables, "RUST_LOG": log})
        self.callback(process.reap)
        return process

    def file(self, name: str, content: bytes) -> Path:
        """Write a private file into the temporary folder."""
        path = self._folder / name
        path.touch(0o600)
        path.write_bytes(content)
        return path


class ZenohProcess(CommandProcess):
    """A process with any number of sessions."""

    def __init__(self, program: Path, log: Path, environment: Mapping[str, str]) -> None:
        self._log = log
        self._log_offset = 0
        words = [sys.executable, "-P", str(program), str(log)]
        super().__init__(words, environment, "the process")

    def ask(self, command: str, *, wait: float = 0.0, **members: object) -> Any:
        """Send a command and return its result.

        Args:
            command: name of a command.
            wait: how many seconds the command may wait; it gets them as ``seconds``.
            members: its other members.

        Raises:
            ZenohError: the library refuses it.
            ProcessFailedError: the process hangs or has died.
        """
        seconds = {"seconds": wait} if wait else {}
        self._send(command, json.dumps({"do": command, **members, **seconds}).encode() + b"\n")
        answer = json.loads(self._line(command, wait))
        if "error" in answer:
            raise ZenohError(answer["error"])
        return answer["result"]

    def open(self, session: str, file: Path, changes: Mapping[str, object]) -> None:
        """Open a session with a configuration.

        Args:
            session: name for it in later commands.
            file: the configuration.
            changes: new values of settings by their path, e.g. ``listen/endpoints``.

        Raises:
            ZenohError: the library refuses the configuration, or a router refuses the session.
        """
        texts = {path: json.dumps(value) for path, value in changes.items()}
        self.ask("open", session=session, file=str(file), changes=texts)

    def decisions(self) -> list[LoggedDecision]:
        """Return the lines about decisions that were logged since the last call."""
        if not self._log.exists():
            return []
        with self._log.open("rb") as log:
            log.seek(self._log_offset)
            content = log.read()
        complete = content[: content.rfind(b"\n") + 1]
        self._log_offset += len(complete)
        return list(access_log.lines(complete.decode(errors="replace")))

    def await_decisions(self, zid: str, fence: str) -> list[LoggedDecision]:
        """Return the decisions about a session that were logged since the last call.

        Wait until they are complete: until there is one about a fence, a key that the session sent after all others, or
        until the log says that no subject matches the session.

        Args:
            zid: identifier of the session.
            fence: the key; its own decisions are not complete.

        Raises:
            ProcessFailedError: the expected decisions do not come.
        """
        found: list[LoggedDecision] = []
        deadline = time.monotonic() + GRACE_SECONDS
        while not any(each.key == fence or not each.message for each in found):
            if time.monotonic() > deadline:
                raise ProcessFailedError("Zenoh did not log a decision for each message")
            if self._process.poll() is not None:
                raise self._died("log")
            time.sleep(0.002)
            found += [each for each in self.decisions() if each.zid == zid]
        return access_log.combined_decisions(each for each in found if each.key != fence)


def installed_version() -> str:
    """Return the version of the installed library, without loading it.

    Raises:
        MissingVendorError: it is not installed, or is too old.
    """
    if importlib.util.find_spec("zenoh") is None:
        raise _missing(f"no library {DISTRIBUTION}")
    try:
        version = importlib.metadata.version(DISTRIBUTION)
    except importlib.metadata.PackageNotFoundError:
        raise _missing(f"no library {DISTRIBUTION}") from None
    numbers = tuple(int(part) if part.isdigit() else 0 for part in version.split(".")[:2])
    if numbers < OLDEST:
        oldest = ".".join(map(str, OLDEST))
        raise _missing(f"{DISTRIBUTION} {version} is older than {oldest}")
    return version


def _missing(reason: str) -> MissingVendorError:
    return MissingVendorError("Zenoh", reason, f"pip install {DISTRIBUTION}, in Keymint's environment {sys.prefix}")
