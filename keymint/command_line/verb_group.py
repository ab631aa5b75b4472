# SPDX-License-Identifier: Apache-2.0
"""Groups of verbs that import a verb on first use, so that ``--help`` is fast."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping
from itertools import pairwise, takewhile
from pathlib import Path
from typing import Any

import click

from comarmor.text import did_you_mean, nearest_word
from keymint.host.streams_and_signals import held_signals

HELP_ALL = "--help-all"


def help_all(*, hidden: bool = False) -> click.Option:
    """Return the option that shows the help page with the options that are hidden otherwise.

    Args:
        hidden: the command has none of them.
    """

    def show(context: click.Context, own: click.Parameter, given: object) -> None:
        if not given or context.resilient_parsing:
            return
        others = (each for each in context.command.params if each is not own)
        # A former name, which works for one release, has no help and is never listed.
        options = [each for each in others if isinstance(each, click.Option) and each.hidden and each.help]
        for each in options:
            each.hidden = False
        click.echo(context.get_help(), color=context.color)
        for each in options:
            each.hidden = True
        context.exit()

    text = None if hidden else "Show this message with the options that few users need."
    return click.Option(
        [HELP_ALL], is_flag=True, is_eager=True, expose_value=False, hidden=hidden, help=text, callback=show
    )


def foreign_words(group: str) -> Mapping[str, str]:
    """Return the words that other tools have for what a group of verbs does, with the verb that does it."""
    import tomllib  # noqa: PLC0415 - only a wrong verb needs it

    content = Path(__file__).with_name("foreign_words.toml").read_text(encoding="utf-8")
    return {
        word: verb
        for verb, words in tomllib.loads(content).get(group.replace(" ", "-"), {}).items()
        for word in words.split()
    }


class VerbCommand(click.Command):
    """A verb, whose unknown options are those of other tools, or misspelt.

    Args:
        declared: makes its parameters, when they are first asked for.
    """

    def __init__(self, *arguments: Any, declared: Callable[[], list[click.Parameter]], **settings: Any) -> None:
        super().__init__(*arguments, **settings)
        self._declared = declared
        del self.params  # the class above has set it

    def __getattr__(self, name: str) -> Any:
        if name != "params":
            raise AttributeError(f"a verb has no attribute {name!r}")
        self.params = self._declared()
        return self.params

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse the arguments; a wrong option is a usage error that never proposes to leave out a check."""
        try:
            return super().parse_args(ctx, self._spelled_out(args))
        except click.NoSuchOption as error:
            known = {name for each in self.params for name in each.opts}
            words = {**foreign_words("options"), **foreign_words(ctx.command_path)}
            said = words.get(error.option_name, "")
            has_it = not said.startswith("-") or said.split()[0] in known
            near = " or ".join(repr(each) for each in error.possibilities or () if not each.startswith("--no-"))
            hint = said if said and has_it else near
            message = f"No such option {error.option_name!r}." + (hint and f" Did you mean {hint}?")
            raise click.NoSuchOption(error.option_name, message, ctx=ctx) from None

    def _spelled_out(self, given: list[str]) -> list[str]:
        """Return arguments with long names for short options: for a short one, click first loads a search for others.

        What follows an option or ``--`` may be a value, and stays; so does a last option that needs a value.
        """
        options = [each for each in self.params if isinstance(each, click.Option)]
        short = {name: each for each in options for name in each.opts if not name.startswith("--")}
        spelled = given.copy()
        for at, (before, word) in enumerate(pairwise(("", *takewhile("--".__ne__, given)))):
            option = None if before.startswith("-") else short.get(word)
            if option and (option.is_flag or at + 1 < len(given)):
                spelled[at] = option.opts[-1]
        return spelled


class VerbGroup(click.Group):
    """Verbs, in groups.

    Args:
        groups: each verb with its help, by the title of its group.
        module: module of a verb, with places for its group in small letters and for its name.
        others: what stands there for the name of a verb whose module has another one.
    """

    def __init__(
        self, *arguments: Any, groups: Mapping[str, Mapping[str, str]], module: str, others: Mapping[str, str],
        **settings: Any,
    ) -> None:  # fmt: skip
        super().__init__(*arguments, **settings)
        self._groups, self._module, self._others = groups, module, others
        self.params.append(help_all(hidden=True))

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names of the verbs."""
        del ctx
        return [verb for verbs in self._groups.values() for verb in verbs]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Return a verb, or None if there is no such one."""
        del ctx
        group = next((title for title, verbs in self._groups.items() if cmd_name in verbs), None)
        if group is None:
            return None
        module = self._module.format(group=group.lower(), verb=self._others.get(cmd_name, cmd_name))
        with held_signals():
            found = vars(importlib.import_module(module)).values()
        return next(each for each in found if isinstance(each, click.Command) and each.name == cmd_name)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Return the verb that is called, and its arguments; a wrong name is a usage error with a suggestion."""
        verbs = self.list_commands(ctx)
        if args and args[0] not in verbs and not args[0].startswith("-"):
            foreign = foreign_words(ctx.command_path)
            word = args[0].lower().replace("_", "-")
            near = word if word in foreign else nearest_word(word, [*verbs, *foreign])
            hint = did_you_mean(args[0], verbs, f"'{ctx.command_path} --help' lists the verbs")
            if near in foreign:
                hint = f"did you mean '{ctx.command_path} {foreign[near]}'?"
            ctx.fail(f"no verb {args[0]!r} ({hint})")
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the verbs with their help."""
        del ctx
        for title, verbs in self._groups.items():
            with formatter.section(title):
                formatter.write_dl(list(verbs.items()))
