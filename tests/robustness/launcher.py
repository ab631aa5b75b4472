# SPDX-License-Identifier: Apache-2.0
"""Runs the command line repeatedly, each time in its own process, so that a tracer can disturb it.

It reads the names of a file of jobs and of one for their results from each line of its input. A fork of it prints its
number, waits until somebody traces it, and runs the jobs:

    strace -f -e inject=renameat:signal=SIGKILL:when=400 … -p NUMBER

strace counts the calls of each process by name, and strikes at one number. Python starts once; every job is a fork,
which first makes as many harmless calls as the call that is meant lacks of that number.
"""

from __future__ import annotations

import contextlib
import ctypes
import fcntl
import io
import json
import os
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Mapping
from pathlib import Path

from keymint.store.file_writing import exchange_names

_NOWHERE = "/nonexistent/robustness"
_PATIENCE = 60
"""Seconds after which nobody is going to trace this."""


def _unlink_at() -> None:
    os.unlink("robustness", dir_fd=_FOLDER)


def _exchange() -> None:
    with contextlib.suppress(OSError):
        exchange_names(_FOLDER, "robustness", "robustness")


_FOLDER = os.open("/proc/self", os.O_RDONLY | os.O_DIRECTORY)
_NULL = os.open(os.devnull, os.O_WRONLY)
HARMLESS: Mapping[str, Callable[[], object]] = {
    "openat": lambda: os.open(_NOWHERE, os.O_RDONLY),
    "write": lambda: os.write(_NULL, b""),
    "fsync": lambda: os.fsync(_NULL),
    "fchmod": lambda: os.fchmod(_NULL, 0o666),
    "renameat": lambda: os.rename(_NOWHERE, _NOWHERE, src_dir_fd=_FOLDER, dst_dir_fd=_FOLDER),
    "renameat2": _exchange,
    "linkat": lambda: os.link(_NOWHERE, _NOWHERE, src_dir_fd=_FOLDER, dst_dir_fd=_FOLDER),
    "mkdir": Path(_NOWHERE).mkdir,
    "mkdirat": lambda: os.mkdir(_NOWHERE, dir_fd=_FOLDER),
    "unlink": Path(_NOWHERE).unlink,
    "unlinkat": _unlink_at,
    "rmdir": Path(_NOWHERE).rmdir,
    "flock": lambda: fcntl.flock(_FOLDER, fcntl.LOCK_UN),
}
"""The calls that change a file system, each with a harmless way to make it."""


def _job(arguments: list[str], call: str, padding: int, output: Path) -> None:
    """Run one job in this process, after a number of harmless calls."""
    from keymint import cli

    shown = os.open(output, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
    os.dup2(shown, 1)
    os.dup2(shown, 2)
    os.close(shown)
    for _ in range(padding):
        with contextlib.suppress(OSError):
            HARMLESS[call]()
    code = cli.main(arguments)
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)


def _warm_up() -> None:
    """Run the command line in this process first, so that jobs import nothing and fill no cache."""
    from keymint import cli

    policy = (
        '<profiles><profile name="p"><attachment>/a</attachment>'
        '<ros_topic qualifier="ALLOW"><attachment>/b</attachment>'
        "<permissions><ros_publish/></permissions></ros_topic></profile></profiles>"
    )
    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()) as said:
        (Path(folder) / "policy.xml").write_text(policy)
        for arguments in (
            ["provision", f"{folder}/policy.xml", "-j", "1"],
            ["install", "--prune", "-j", "1"],
            ["check"],
        ):
            code = cli.main([*arguments, "-w", f"{folder}/ws"])
            assert code == 0, said.getvalue()


def _wait_for_tracer() -> None:
    """Let any process of this user trace this one, even where a process traces its children only (Yama), and wait."""
    ctypes.CDLL(None).prctl(0x59616D61, ctypes.c_ulong(-1), 0, 0, 0)  # PR_SET_PTRACER, PR_SET_PTRACER_ANY
    sys.stdout.write(f"{os.getpid()}\n")
    sys.stdout.flush()
    status = os.open("/proc/self/status", os.O_RDONLY)
    until = time.monotonic() + _PATIENCE
    while b"TracerPid:\t0\n" in os.pread(status, 4096, 0):
        if time.monotonic() > until:
            os._exit(98)
        time.sleep(0.001)
    os.close(status)


def _run(jobs: Path, results: Path) -> None:
    """Run all jobs, and write the result of each: its :func:`os.waitstatus_to_exitcode` and its output."""
    ended = []
    output = results.with_suffix(".output")
    for arguments, call, padding in json.loads(jobs.read_text()):
        sys.stdout.flush()
        process = os.fork()
        if not process:
            try:
                _job(arguments, call, padding, output)
            except BaseException:  # noqa: BLE001 - nothing may return into the loop of the parent
                traceback.print_exc()
            os._exit(99)
        _, status = os.waitpid(process, 0)
        ended.append([process, os.waitstatus_to_exitcode(status), output.read_text(errors="replace")])
    results.write_text(json.dumps(ended))


def main() -> None:
    """Run jobs until the input ends."""
    _warm_up()
    for line in sys.stdin:
        process = os.fork()
        if not process:
            os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
            _wait_for_tracer()
            jobs, results = line.split()
            _run(Path(jobs), Path(results))
            os._exit(0)
        os.waitpid(process, 0)


if __name__ == "__main__":
    main()
