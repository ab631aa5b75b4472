# SPDX-License-Identifier: Apache-2.0
"""Runs the command line with an audit hook, to see which of our modules open, write or list files, or start processes.

    python -m tests.audited FOLDER < steps.json

FOLDER is the current folder of all steps. A step is a list of arguments. Prints the exit codes and a list of events in
JSON: the step, the kind of event, the path or program, and the innermost module of ours on the stack.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import sys
from pathlib import Path
from typing import Any

CHECKOUT = Path(__file__).resolve().parent.parent
OURS = tuple(f"{CHECKOUT / room}{os.sep}" for room in ("comarmor", "keymint", "plugins"))

CHANGES = {
    *("os.chmod", "os.chown", "os.link", "os.mkdir", "os.remove", "os.rename", "os.rmdir", "os.symlink", "os.truncate"),
    *("os.utime", "os.setxattr", "os.removexattr", "shutil.move", "shutil.rmtree", "shutil.copyfile"),
    *("tempfile.mkdtemp", "tempfile.mkstemp", "sqlite3.connect"),
}
"""Events that change the file system (Python's table of audit events)."""
STARTS = {"subprocess.Popen", "os.system", "os.exec", "os.posix_spawn", "os.fork", "socket.connect", "socket.bind"}
LISTS = {"os.listdir", "os.scandir"}
WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND


class Recorder:
    """Collects the events that our modules cause."""

    def __init__(self) -> None:
        self.step = 0
        self.events: dict[tuple[Any, ...], None] = {}

    def __call__(self, event: str, arguments: tuple[Any, ...]) -> None:
        kind = self._kind(event, arguments)
        if kind and (module := self._module()):
            self.events[self.step, kind, _text(arguments[0] if arguments else ""), module] = None

    @staticmethod
    def _kind(event: str, arguments: tuple[Any, ...]) -> str:
        if event == "open":
            return "write" if arguments[2] & WRITING else "read"
        if event == "sqlite3.connect" and str(arguments[0]).endswith((":memory:", "?vfs=memdb")):  # no file
            return ""
        if event in CHANGES:
            return "write"
        if event in LISTS:
            return "list"
        return "start" if event in STARTS else ""

    @staticmethod
    def _module() -> str:
        frame = sys._getframe(2)
        while frame is not None:
            if frame.f_code.co_filename.startswith(OURS):
                return os.path.relpath(frame.f_code.co_filename, CHECKOUT)
            frame = frame.f_back  # type: ignore[assignment]
        return ""


def _text(path: object) -> str:
    return os.fsdecode(path) if isinstance(path, str | bytes | os.PathLike) else str(path)


def main() -> None:
    steps = json.load(sys.stdin)
    os.chdir(sys.argv[1])
    sys.dont_write_bytecode = True
    from keymint import cli

    recorder = Recorder()
    sys.addaudithook(recorder)
    codes = []
    for number, arguments in enumerate(steps):
        recorder.step = number
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            codes.append(cli.main(arguments))
    json.dump({"codes": codes, "events": list(recorder.events)}, sys.stdout)


if __name__ == "__main__":
    main()
