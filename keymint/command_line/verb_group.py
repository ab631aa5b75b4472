# SPDX-License-Identifier: Apache-2.0
"""Groups of verbs that import a verb on first use, so that ``--help`` is fast."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from types import MappingProxyType

import click

from comarmor.text import did_you_mean
from keymint.host.streams_and_signals import held_signals


class VerbGroup(click.Group):
    """A group of verbs.

    Attributes:
        VERBS: each verb with its help.
        MODULE: module of a verb, with a place for its name.
        NAME: name of the command in its module, with a place for the name of the verb.
        MODULES: what stands for the name of a verb in both, where that is a keyword of Python.
    """

    VERBS: Mapping[str, str]
    MODULE = "keymint.commands.{}"
    NAME = "{}"
    MODULES: Mapping[str, str] = MappingProxyType({})

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names of the verbs."""
        del ctx
        return list(self.VERBS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Return a verb, or None if there is no such one."""
        del ctx
        if cmd_name not in self.VERBS:
            return None
        name = self.MODULES.get(cmd_name, cmd_name)
        with held_signals():
            module = importlib.import_module(self.MODULE.format(name))
        command: click.Command = getattr(module, self.NAME.format(name))
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Return the verb that is called, and its arguments; a wrong name is a usage error with a suggestion."""
        if args and args[0] not in self.VERBS and not args[0].startswith("-"):
            hint = did_you_mean(args[0], self.VERBS, f"'{ctx.command_path} --help' lists the verbs")
            ctx.fail(f"no verb {args[0]!r} ({hint})")
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the verbs with their help."""
        del ctx
        with formatter.section("Verbs"):
            formatter.write_dl(list(self.VERBS.items()))
