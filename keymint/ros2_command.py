# SPDX-License-Identifier: Apache-2.0
"""``ros2 keymint``: the command line of Keymint as a command of ``ros2``, found by the entry point ``ros2cli.command``.

``ros2`` asks for a class that can be called without arguments, and calls ``add_arguments`` and ``main`` (ros2cli,
``command/__init__.py`` and ``cli.py``); it does not ask for its own base class. So nothing of ROS is imported. ``ros2``
loads every command for its own ``--help``, so this module imports next to nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from argparse import ArgumentParser, Namespace

_ARGUMENTS = "keymint_arguments"


class KeymintCommand:
    """Mint keys and notarize access control for robots."""

    NAME = "keymint"
    EXTENSION_POINT_VERSION = "0.1"

    def add_arguments(self, parser: ArgumentParser, cli_name: str) -> None:
        """Let a parser take all arguments as they are, ``--help`` and options before the verb included.

        ``argparse.REMAINDER`` takes no option in front of the first word (python/cpython#61252).

        Args:
            parser: the parser for the arguments after ``ros2 keymint``.
            cli_name: ``ros2 keymint``.
        """
        del cli_name
        parse = parser.parse_known_args

        def take_all(
            args: Sequence[str] | None = None, namespace: Namespace | None = None
        ) -> tuple[Namespace, list[str]]:
            found, _ = parse([], namespace)  # for the defaults, by which ros2 finds this command again
            setattr(found, _ARGUMENTS, list(args or ()))
            return found, []

        parser.parse_known_args = take_all  # type: ignore[method-assign, assignment]

    def main(self, *, parser: ArgumentParser, args: Namespace) -> int:
        """Run the command line, and return its exit code.

        Args:
            parser: the parser.
            args: what it parsed.
        """
        del parser
        from keymint.__main__ import run  # noqa: PLC0415 - ros2 loads this class for its own help

        return run(getattr(args, _ARGUMENTS))
