# SPDX-License-Identifier: Apache-2.0
"""Run the command line on a real terminal."""

from __future__ import annotations

import os
import pty
import subprocess
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

from tests.conftest import CHECKOUT, Outcome

KEYMINT = ("-m", "keymint")


def on_terminal(
    arguments: Sequence[object], folder: Path, answer: str, *, program: Sequence[str] = KEYMINT, stdin: bool = True
) -> Outcome:
    """Run a command whose standard error is a terminal, and return what was shown there as ``err``.

    Args:
        arguments: those of the command line.
        folder: the current directory.
        answer: what is typed.
        program: arguments of the interpreter.
        stdin: standard input is the terminal, too; else it has the answer.
    """
    with _terminal() as (ours, theirs):
        command = [sys.executable, *program, *map(str, arguments)]
        given = theirs if stdin else subprocess.PIPE
        process = subprocess.Popen(
            command, cwd=folder, stdin=given, stdout=subprocess.PIPE, stderr=theirs,
            env=os.environ | {"TERM": "dumb", "PYTHONPATH": os.fspath(CHECKOUT)},
        )  # fmt: skip
        os.close(theirs)
        if stdin:
            os.write(ours, answer.encode())
        with ThreadPoolExecutor(1) as reader:  # a terminal holds little that nobody reads
            shown = reader.submit(lambda: "".join(_shown(ours)))
            out, _ = process.communicate(None if stdin else answer.encode())
        return Outcome(process.returncode, out.decode(), shown.result().replace("\r\n", "\n"))


@contextmanager
def _terminal() -> Iterator[tuple[int, int]]:
    ours, theirs = pty.openpty()
    try:
        yield ours, theirs
    finally:
        os.close(ours)


def _shown(terminal: int) -> Iterator[str]:
    """Yield what was written to a terminal that nobody has open any more."""
    while True:
        try:
            found = os.read(terminal, 65536)
        except OSError:
            return
        if not found:
            return
        yield found.decode()
