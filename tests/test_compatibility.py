# SPDX-License-Identifier: Apache-2.0
"""What a version promises (docs/compatibility.md) is listed, and nothing of it goes unnoticed."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path

import click

from keymint.api import API_VERSION
from keymint.cli import cli

CHECKOUT = Path(__file__).resolve().parents[1]
COMMAND_LINE = Path(__file__).with_name("golden_command_line.txt")
PAGE = (CHECKOUT / "docs" / "compatibility.md").read_text()


def calls(name: str, command: click.Command) -> Iterator[str]:
    """Yield a line for each verb: its arguments, and its options but those that only warn of their new name."""
    words = []
    for each in command.params:
        if isinstance(each, click.Argument):
            words.append(each.make_metavar(click.Context(command)))
        elif isinstance(each, click.Option) and each.help:
            value = "" if each.is_flag or each.count else f"={'|'.join(getattr(each.type, 'choices', ())) or 'VALUE'}"
            words += (option + value for option in (*each.opts, *each.secondary_opts))
    yield " ".join([name, *sorted(words)])
    if isinstance(command, click.Group):
        context = click.Context(command)
        for below in command.list_commands(context):
            found = command.get_command(context, below)
            assert found is not None
            yield from calls(f"{name} {below}", found)


def test_each_verb_and_option_is_on_the_list() -> None:
    """A word that goes, or changes, breaks a promise: it is for a major version. A new one is added to the list."""
    assert sorted(calls("keymint", cli)) == COMMAND_LINE.read_text().splitlines()


def promised(row: str) -> str:
    """Return the version that the table promises for an interface."""
    match = re.search(rf"^\| .*{re.escape(row)}.* \| .*version (\d+)", PAGE, re.MULTILINE)
    assert match is not None
    return match[1]


def test_the_versions_of_formats_are_those_that_the_page_promises() -> None:
    schemas = CHECKOUT / "schemas" / "keymint"
    versions = {
        row: str(json.loads((schemas / f"{name}.schema.json").read_text())["properties"]["version"]["const"])
        for row, name in {"`--json`": "report", "graph files": "graph", "bundles": "bundle"}.items()
    }
    versions["plugins"] = API_VERSION.partition(".")[0]
    assert {row: promised(row) for row in versions} == versions


def test_the_exit_codes_of_the_help_are_those_that_the_page_promises() -> None:
    assert cli.help is not None
    help_text = " ".join(cli.help.split())
    listed = re.search(r"^\| exit codes \| (.*?) \|", PAGE, re.MULTILINE)
    assert listed is not None
    assert f"Exit codes: {listed[1]}." in help_text
