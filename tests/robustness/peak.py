# SPDX-License-Identifier: Apache-2.0
"""The memory that a run of the command line takes at most, measured in its own process."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

MOST = 200
"""Megabytes that a run takes at most for a file that it refuses."""
_ADDRESS_SPACE = 4 << 30
"""Bytes that a run may allocate: a reader without a bound must not take the machine with it."""
_RUN = """
import os, resource, sys
resource.setrlimit(resource.RLIMIT_AS, (int(sys.argv[1]),) * 2)
report = int(sys.argv[2])
del sys.argv[1:3]

def say():
    # Unlike ru_maxrss, this is not what the process had before it ran Python.
    own = next(int(line.split()[1]) for line in open("/proc/self/status") if line.startswith("VmHWM"))
    os.write(report, b"%d" % max(own, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss))

from keymint.__main__ import main
try:
    main()
finally:
    say()
"""


@dataclass(frozen=True)
class Ran:
    """A run: its exit code, its messages, and its peak in megabytes, with its largest child."""

    code: int
    err: str
    peak: float


def run(arguments: Sequence[str], cwd: Path) -> Ran:
    """Run the command line."""
    reading, writing = os.pipe()
    with os.fdopen(reading, "rb") as report:
        try:
            done = subprocess.run(
                [sys.executable, "-c", _RUN, str(_ADDRESS_SPACE), str(writing), *arguments],
                cwd=cwd,
                pass_fds=[writing],
                capture_output=True,
                text=True,
                errors="backslashreplace",
                timeout=300,
                check=False,
            )
        finally:
            os.close(writing)
        return Ran(done.returncode, done.stdout + done.stderr, int(report.read() or b"0") * 1024 / 1e6)
