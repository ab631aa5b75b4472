# SPDX-License-Identifier: Apache-2.0
"""``ros2 keymint`` for a Keymint that is installed apart from ROS: runs the command ``keymint`` with all arguments."""

from __future__ import annotations

import os
import sys
from argparse import ArgumentParser, Namespace
from typing import Sequence  # noqa: UP035 - for Python 3.8


class KeymintCommand:
    """Mint keys and notarize access control for robots."""

    NAME = "keymint"
    EXTENSION_POINT_VERSION = "0.1"

    def add_arguments(self, parser: ArgumentParser, cli_name: str) -> None:
        """Let a parser take all arguments as they are, ``--help`` included."""
        del cli_name
        parse = parser.parse_known_args

        def take_all(
            args: Sequence[str] | None = None, namespace: Namespace | None = None
        ) -> tuple[Namespace, list[str]]:
            found, _ = parse([], namespace)
            found.keymint_arguments = list(args or ())
            return found, []

        parser.parse_known_args = take_all

    def main(self, *, parser: ArgumentParser, args: Namespace) -> None:
        """Become ``keymint``: signals and the exit code are its own."""
        del parser
        sys.stdout.flush()
        environment = dict(os.environ)
        environment.pop("PYTHONPATH", None)  # that of ROS, whose Python may be another one
        command = ["keymint", *args.keymint_arguments]
        try:
            os.execvpe(command[0], command, environment)  # noqa: S606 - there is no shell in between
        except OSError as error:
            hint = "install it, e.g. by 'pipx install .' in a checkout"
            raise RuntimeError(f"cannot run keymint: {error.strerror}; {hint}") from None
