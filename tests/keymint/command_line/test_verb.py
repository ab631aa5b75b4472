# SPDX-License-Identifier: Apache-2.0
"""How verbs declare their options."""

from __future__ import annotations

import click
import pytest
from click.testing import CliRunner

from comarmor.values import Data
from keymint.command_line.options import Number
from keymint.command_line.verb import OptionGroup, flag, option, option_group, parameters_of
from keymint.errors import ExitCode, usage_error


class Group(Data):
    """Two options of a command line, and a field that is none.

    Options:
        second: Said.
    """

    first: str | None
    second: bool = flag()
    rest: str = "default"


def verb(
    group: Group = option_group(Group, first=option()), other_name: str = option("-o", default="o"), *, rest: int = 1
) -> None:
    """Stand for a verb."""


def test_the_arguments_of_a_function_declare_options() -> None:
    seen: list[object] = []
    parameters, groups = parameters_of(verb)

    def command(**values: object) -> None:
        seen.extend((groups["group"].taken(values), values))

    made = click.Command("verb", params=parameters, callback=command)
    result = CliRunner().invoke(made, ["--second", "--first", "x"])
    assert result.exit_code == 0, result.output
    assert seen == [Group("x", second=True), {"other_name": "o"}]
    lines = CliRunner().invoke(made, ["--help"]).output.splitlines()
    assert [line.split()[:2] for line in lines if line.startswith("  -")] == [
        ["--second", "Said."],
        ["--first", "TEXT"],
        ["-o,", "--other-name"],
        ["--help", "Show"],
    ]


def test_options_that_exclude_each_other() -> None:
    def refuse(_group: object) -> None:
        raise click.UsageError("not both")

    group: OptionGroup = option_group(Group, refuse, first=option())
    with pytest.raises(click.UsageError, match="not both"):
        group.taken({"first": None, "second": True})


@pytest.mark.parametrize("text", ["nan", "-1", "11", "x"])
def test_numbers_outside_of_their_range_are_refused(text: str) -> None:
    with pytest.raises(click.BadParameter):
        Number(0, 10).convert(text, None, None)


def test_a_usage_error_ends_with_exit_code_2() -> None:
    error = usage_error("wrong", "do it right")
    assert error.exit_code is ExitCode.USAGE
    assert (error.diagnostics[0].code, error.diagnostics[0].help) == ("usage", "do it right")
