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
    """Verbs, in groups.

    Attributes:
        GROUPS: each verb with its help, by the title of its group.
        MODULE: module of a verb, with places for its group in small letters and for its name.
        MODULES: what stands there for the name of a verb whose module has another one.
    """

    GROUPS: Mapping[str, Mapping[str, str]]
    MODULE = "keymint.commands.{group}.{verb}"
    MODULES: Mapping[str, str] = MappingProxyType({})

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names of the verbs."""
        del ctx
        return [verb for verbs in self.GROUPS.values() for verb in verbs]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Return a verb, or None if there is no such one."""
        del ctx
        group = next((title for title, verbs in self.GROUPS.items() if cmd_name in verbs), None)
        if group is None:
            return None
        module = self.MODULE.format(group=group.lower(), verb=self.MODULES.get(cmd_name, cmd_name))
        with held_signals():
            found = vars(importlib.import_module(module)).values()
        return next(each for each in found if isinstance(each, click.Command) and each.name == cmd_name)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Return the verb that is called, and its arguments; a wrong name is a usage error with a suggestion."""
        verbs = self.list_commands(ctx)
        if args and args[0] not in verbs and not args[0].startswith("-"):
            hint = did_you_mean(args[0], verbs, f"'{ctx.command_path} --help' lists the verbs")
            ctx.fail(f"no verb {args[0]!r} ({hint})")
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the verbs with their help."""
        del ctx
        for title, verbs in self.GROUPS.items():
            with formatter.section(title):
                formatter.write_dl(list(verbs.items()))
