"""``python -m keymint`` and the command ``keymint``."""

from __future__ import annotations

import sys


def main() -> None:
    """Run the command line and end the process with its exit code."""
    try:
        from keymint import cli  # noqa: PLC0415 - an interrupt while it is imported is handled as well

        code = cli.main()
    except KeyboardInterrupt:
        sys.stderr.write("keymint: interrupted\n")
        code = 130  # ExitCode.INTERRUPTED, which may not have been imported yet
    sys.exit(code)


if __name__ == "__main__":
    main()
