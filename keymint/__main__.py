# SPDX-License-Identifier: Apache-2.0
"""``python -m keymint`` and the command ``keymint``."""

from __future__ import annotations

import atexit
import gc
import os
import sys

gc.set_threshold(1_000_000, 20, 50)  # imports and a run create many objects, few of them in cycles

from keymint.host import streams_and_signals  # noqa: E402 - creates many of them


def run(arguments: list[str]) -> int:
    """Run the command line as the only task of this process, and return its exit code."""
    streams_and_signals.open_missing_streams()
    streams_and_signals.hold_signals()
    from keymint import cli  # noqa: PLC0415 - signals wait until the import is done

    streams_and_signals.stop_on_signals()
    try:
        streams_and_signals.release_signals()
        code = cli.main(arguments)
    except streams_and_signals.StoppedError as stop:
        code = cli.report_signal(arguments, stop.number)
    gc.freeze()  # nothing is searched for cycles any more
    return code


def main() -> None:
    """Run the command line and end the process with its exit code."""
    codes: list[int] = []
    atexit.register(_end, codes)  # what is registered later runs before
    codes.append(run(sys.argv[1:]))
    sys.exit(codes[0])


def _end(codes: list[int]) -> None:
    """End the process without freeing each object, which takes as long as a twentieth of a run."""
    if codes and "pkcs11" not in sys.modules:  # a token's module may have something to finish
        for stream in filter(None, (sys.stdout, sys.stderr)):
            stream.flush()
        os._exit(codes[0])


if __name__ == "__main__":
    main()
