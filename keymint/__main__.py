# SPDX-License-Identifier: Apache-2.0
"""``python -m keymint`` and the command ``keymint``."""

from __future__ import annotations

import gc
import sys

from keymint import process


def main() -> None:
    """Run the command line and end the process with its exit code."""
    process.open_missing_streams()
    process.hold_signals()
    from keymint import cli  # noqa: PLC0415 - signals wait until the import is done

    process.stop_on_signals()
    try:
        process.release_signals()
        code = cli.main()
    except process.StoppedError as stop:
        code = cli.stopped(sys.argv[1:], stop.number)
    gc.freeze()  # the process ends: nothing is searched for cycles any more
    sys.exit(code)


if __name__ == "__main__":
    main()
