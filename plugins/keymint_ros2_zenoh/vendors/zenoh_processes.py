# SPDX-License-Identifier: Apache-2.0
"""Processes with real Zenoh sessions, routers among them, and their decisions, which they write into their log.

They need Zenoh's library for Python: a wheel with access control, TLS, and routers. :mod:`session_program` lists their
commands.

With :data:`FILTER` in ``RUST_LOG`` each decision is a line. When a session declares a publisher on a literal key, both
ends of its link decide on this key at once, for all messages and both flows, and nothing is sent. For a key with
wildcards only the messages that are really sent are decided. If several subjects match a link, each has its line, and
one that allows is enough. A link that no subject matches is decided when it opens, once for all messages.
"""

from __future__ import annotations

import importlib.metadata
import importlib.util
import json
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Self

from comarmor.text import lazy_regex
from comarmor.values import Data, replace
from keymint.host.vendor_process import GRACE_SECONDS, CommandProcess, MissingVendorError, ProcessFailedError
from keymint_ros2_zenoh.documents.configuration import Message

FILTER = "zenoh::net::routing::interceptor::access_control=trace"

MESSAGES = {each.removeprefix("declare_").replace("_", " ").title(): each.value for each in Message}
"""The names of messages in a configuration by those in the log, without ``Declare`` and ``Undeclare``."""

_COLOUR = lazy_regex(r"\x1b\[[0-9;]*m")
_DECISION = lazy_regex(
    r" (?:(?P<zid>[0-9a-f]+) on Interface\(.*|Using cached result: (?P<cached>[0-9a-f]+)) "
    r"is (?P<refused>un)?authorized to (?:Declare/Undeclare |Declare |Undeclare )?"
    r"(?P<message>" + "|".join(sorted(MESSAGES, key=len, reverse=True)) + r") "
    r"\((?P<flow>ingress|egress)\) on (?P<key>.+)\n"
)
_NO_SUBJECT = lazy_regex(
    r" (?P<zid>[0-9a-f]+) did not match any configured ACL subject\. Default permission `(?P<default>Allow|Deny)`"
)


class LoggedDecision(Data):
    """A decision of Zenoh, or of one of several subjects that match the link.

    Attributes:
        zid: identifier of the session at the other end of the link.
        allowed: the decision.
        message: as configurations name it; empty if no subject matches the link, which decides all its messages.
        flow: ``ingress`` or ``egress``, as seen from the process that decides; empty for all messages.
        key: the key expression of the message; empty for all messages.
    """

    zid: str
    allowed: bool
    message: str = ""
    flow: str = ""
    key: str = ""


def combined_decisions(lines: Iterable[LoggedDecision]) -> list[LoggedDecision]:
    """Return one decision for each link, message, flow and key: allowed if one of the subjects allows."""
    found: dict[LoggedDecision, bool] = {}
    for line in lines:
        what = replace(line, allowed=False)
        found[what] = found.get(what, False) or line.allowed
    return [replace(what, allowed=allowed) for what, allowed in found.items()]


def lines(log: str) -> Iterator[LoggedDecision]:
    """Yield the lines of a log that are decisions, in order; an unfinished last line is none."""
    for coloured in log.splitlines(keepends=True):
        line = _COLOUR.sub("", coloured)
        if found := _DECISION.search(line):
            allowed, zid = not found["refused"], found["zid"] or found["cached"]
            yield LoggedDecision(zid, allowed, MESSAGES[found["message"]], found["flow"], found["key"])
        elif found := _NO_SUBJECT.search(line):
            yield LoggedDecision(found["zid"], found["default"] == "Allow")


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
            log: what the library logs, as in ``RUST_LOG``; :data:`FILTER` for decisions.
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
            with self._log.open("rb") as log:
                log.seek(self._log_offset)
                content = log.read()
            complete = content[: content.rfind(b"\n") + 1]
            self._log_offset += len(complete)
            found += [each for each in lines(complete.decode(errors="replace")) if each.zid == zid]
        return combined_decisions(each for each in found if each.key != fence)


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
