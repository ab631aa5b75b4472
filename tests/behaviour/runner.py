# SPDX-License-Identifier: Apache-2.0
"""Runs the command line of one checkout: each command in a process of its own, forked when all modules are loaded.

A program of its own: it is started with a checkout on ``PYTHONPATH``, reads requests from standard input, a JSON
document on each line, and answers each with a line. It knows nothing of a checkout but ``keymint.cli.main``.
"""

from __future__ import annotations

import atexit
import importlib
import json
import os
import shutil
import signal
import sys
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

SECONDS = 120
"""A command that takes longer is killed; its exit code is then that of SIGALRM, -14."""


def _main(argv: list[str]) -> int:
    from keymint.cli import main

    return main(argv)


def _in_a_fork(request: Mapping[str, Any], files: list[Path], what: Callable[[list[str]], int]) -> int:
    """Call a function with the arguments of a request, in a forked process; return its exit code."""
    pid = os.fork()
    if pid:
        return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
    code = 70
    try:
        for number, (file, flags) in enumerate(zip(files, (os.O_RDONLY, os.O_WRONLY, os.O_WRONLY), strict=True)):
            opened = os.open(file, flags)
            os.dup2(opened, number)
            os.close(opened)
        # The buffered reader of standard input belongs to the requests, and must not be read on.
        sys.stdin = open(0, encoding="utf-8", closefd=False)  # noqa: SIM115
        sys.stdout = open(1, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
        sys.stderr = open(2, "w", encoding="utf-8", errors="backslashreplace", closefd=False)  # noqa: SIM115
        os.environ.clear()
        os.environ.update(request["env"])
        os.chdir(request["cwd"])
        os.umask(0o022)
        signal.alarm(SECONDS)
        sys.argv = ["keymint", *request["argv"]]
        code = what(request["argv"])
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else 1
    except BaseException as error:  # noqa: BLE001 - a crash is a result as well
        sys.stderr.write(f"uncaught {type(error).__name__}: {error}\n")
    finally:
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
        atexit._run_exitfuncs()
        os._exit(code)


def _loads(argv: list[str]) -> int:
    """Run a command, and print the names of all modules that it loaded."""
    _main(argv)
    sys.stdout.write("\n" + json.dumps(sorted(sys.modules)) + "\n")
    return 0


def serve() -> None:
    """Answer requests until the end of standard input.

    A request with ``warm`` loads the modules that its command needs. The command itself runs in a fork, so that no
    command finds what another one computed.
    """
    requests, answers = sys.stdin, sys.stdout
    # Not a TemporaryDirectory: the forked processes would remove it as they end.
    folder = Path(tempfile.mkdtemp())
    try:
        files = [folder / name for name in ("in", "out", "err")]
        for line in requests:
            request = json.loads(line)
            for file in files:
                file.write_text(request.get("stdin", "") if file == files[0] else "", encoding="utf-8")
            code = _in_a_fork(request, files, _loads if request.get("warm") else _main)
            out, err = (file.read_bytes().decode("utf-8", "backslashreplace") for file in files[1:])
            if request.get("warm"):
                for name in json.loads(out.splitlines()[-1]):
                    try:
                        importlib.import_module(name)
                    except ImportError:  # a module that another one put there under this name
                        continue
            answers.write(json.dumps({"code": code, "out": out, "err": err}) + "\n")
            answers.flush()
    finally:
        shutil.rmtree(folder)


if __name__ == "__main__":
    serve()
