"""``python -m keymint`` and the command ``keymint``."""

from __future__ import annotations

import sys


def main() -> None:
    """Run the command line and end the process with its exit code."""
    from keymint import cli  # noqa: PLC0415 - an interrupt while it is imported is handled as well

    sys.exit(cli.main())


if __name__ == "__main__":
    main()
