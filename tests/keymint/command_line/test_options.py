# SPDX-License-Identifier: Apache-2.0
"""Options that several verbs share."""

from __future__ import annotations

from dataclasses import dataclass

import click
import pytest
from click.testing import CliRunner

from keymint.command_line.options import Number, option_group
from keymint.errors import ExitCode, usage_error


@dataclass(frozen=True)
class Group:
    """Two options of a command line, and a field that is none."""

    first: str | None
    second: bool
    rest: str = "default"


def test_a_group_of_options_reaches_the_command_as_one_argument() -> None:
    seen: list[object] = []

    @click.command()
    @option_group("group", Group, click.option("--first"), click.option("--second", is_flag=True))
    @click.option("--other", default="o")
    def command(group: Group, other: str) -> None:
        seen.extend((group, other))

    result = CliRunner().invoke(command, ["--second", "--first", "x"])
    assert result.exit_code == 0, result.output
    assert seen == [Group("x", second=True), "o"]
    lines = CliRunner().invoke(command, ["--help"]).output.splitlines()
    assert [line.split()[0] for line in lines if line.startswith("  --")] == [
        "--first",
        "--second",
        "--other",
        "--help",
    ]


@pytest.mark.parametrize("text", ["nan", "-1", "11", "x"])
def test_numbers_outside_of_their_range_are_refused(text: str) -> None:
    with pytest.raises(click.BadParameter):
        Number(0, 10).convert(text, None, None)


def test_a_usage_error_ends_with_exit_code_2() -> None:
    error = usage_error("wrong", "do it right")
    assert error.exit_code is ExitCode.USAGE
    assert (error.diagnostics[0].code, error.diagnostics[0].help) == ("usage", "do it right")
