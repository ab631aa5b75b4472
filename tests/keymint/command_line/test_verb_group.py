# SPDX-License-Identifier: Apache-2.0
"""A group of verbs imports the verb that is called, and suggests one for a name that is none."""

from __future__ import annotations

import inspect
import subprocess
import sys
from collections.abc import Callable, Sequence
from unittest import mock

import click
import pytest
from hypothesis import given, strategies as st

from keymint.cli import cli
from keymint.command_line.verb import option_texts
from keymint.command_line.verb_group import VerbCommand, VerbGroup, foreign_words
from keymint.commands.life.authority import authority
from tests.conftest import Outcome


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (("autority",), "error: no verb 'autority' (did you mean 'authority'?) [usage]"),
        (("authority", "shwo"), "error: no verb 'shwo' (did you mean 'show'?) [usage]"),
        (("authority", "x"), "error: no verb 'x' ('keymint authority --help' lists the verbs) [usage]"),
        (("plan",), "error: no verb 'plan' (did you mean 'keymint provision --dry-run'?) [usage]"),
        (("list_enclaves",), "error: no verb 'list_enclaves' (did you mean 'keymint status'?) [usage]"),
        (("new-cert",), "error: no verb 'new-cert' (did you mean 'keymint request'?) [usage]"),
        (("Docter",), "error: no verb 'Docter' (did you mean 'keymint check'?) [usage]"),
        (("authority", "rotate"), "error: no verb 'rotate' (did you mean 'keymint authority replace'?) [usage]"),
    ],
)
def test_a_name_that_is_no_verb(keymint: Callable[..., Outcome], given: tuple[str, ...], said: str) -> None:
    outcome = keymint(*given)
    assert outcome.code == 2
    assert outcome.err == f"{said}\n"


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ("provision x --auto-approve", " Did you mean --yes?"),
        ("renew -y", " Did you mean --yes?"),
        ("check --auto-approve", ""),
        ("renew --all", " Did you mean 'keymint renew' without a NAME?"),
        ("renew --within 3d", " Did you mean --threshold?"),
        ("lint --format sarif", " Did you mean --sarif or --json?"),
        ("lint --junit x", " Did you mean --sarif or --json?"),
        ("lint --sarf x", " Did you mean '--sarif'?"),
    ],
)
def test_an_option_of_other_tools(keymint: Callable[..., Outcome], given: str, said: str) -> None:
    outcome = keymint(*given.split())
    assert outcome.code == 2
    (message,) = (line for line in outcome.err.splitlines() if "No such option" in line)
    assert "--no-" not in message
    assert message.endswith(f".{said} [usage]" if said else "' [usage]")


@pytest.mark.parametrize("group", [cli, authority], ids=["keymint", "authority"])
def test_words_of_other_tools_name_verbs(group: VerbGroup) -> None:
    path = "keymint" if group is cli else f"keymint {group.name}"
    context = click.Context(cli)
    for word, said in foreign_words(path).items():
        assert word == word.lower().replace("_", "-")
        assert word not in group.list_commands(context)
        name, *arguments = said.split()
        if name.startswith("--"):
            assert name in {"--help", "--version"}
            continue
        command = group.get_command(context, name)
        assert command is not None, said
        options = {each for parameter in command.params for each in parameter.opts}
        verbs = command.list_commands(context) if isinstance(command, click.Group) else []
        assert {*arguments} <= {*options, *verbs}, said


@pytest.mark.parametrize("group", [cli, authority], ids=["keymint", "authority"])
def test_each_option_has_a_text_and_each_text_an_option(group: VerbGroup) -> None:
    context = click.Context(cli)
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        if command is None or command.callback is None or isinstance(command, click.Group):
            continue
        options = {str(each.name): each for each in command.params if isinstance(each, click.Option)}
        silent = {option for option, each in options.items() if not (each.help or each.hidden)}
        assert silent <= {"kind"} if name == "diff" else not silent, name  # its values say it
        assert option_texts(inspect.unwrap(command.callback))[1].keys() <= options.keys(), name


@pytest.mark.parametrize("group", [(), ("authority",)], ids=["verbs", "authority"])
def test_help_imports_no_verb(group: tuple[str, ...]) -> None:
    program = (
        "import sys; from keymint.cli import main; main(sys.argv[1:]);"
        "print(sorted(each for each in sys.modules if each.startswith('keymint.commands.')), file=sys.stderr)"
    )
    command = [sys.executable, "-c", program, *group, "--help"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    imported = ["keymint.commands.life", "keymint.commands.life.authority"] if group else []
    assert done.stderr == f"{imported}\n"


def test_wrong_arguments_are_one_line_with_what_was_expected(keymint: Callable[..., Outcome]) -> None:
    expected = "error: Got unexpected extra argument (ws); expected: keymint provision [OPTIONS] POLICY"
    hint = "(a workspace is named by -w: -w ws)"
    assert keymint("provision", "policy.xml", "ws").err == f"{expected} {hint} [usage]\n"


def parsed(command: click.Command, given: Sequence[str]) -> object:
    """Return what a command reads from arguments, or what it says about them."""
    try:
        return command.make_context("verb", list(given)).params
    except click.UsageError as error:
        return error.format_message()


PARAMETERS = [
    click.Argument(["names"], nargs=-1),
    click.Option(["-w", "--workspace"]),
    click.Option(["-q", "--quiet"], is_flag=True),
    click.Option(["--because"]),
]
WORDS = ["-w", "-q", "-wq", "-qw", "-x", "--", "-", "x", "--because", "--quiet", "--workspace=x"]


@given(st.lists(st.sampled_from(WORDS)))
def test_short_options_mean_what_click_reads_from_them(words: list[str]) -> None:
    verb = VerbCommand("verb", declared=lambda: PARAMETERS)
    assert parsed(verb, words) == parsed(click.Command("verb", params=PARAMETERS), words)


def test_short_options_load_no_search_for_similar_names() -> None:
    with mock.patch.dict(sys.modules, {"difflib": None}):
        verb = VerbCommand("verb", declared=lambda: PARAMETERS)
        found = parsed(verb, ["-q", "x", "-w", "y", "-q"])
    assert found == {"names": ("x",), "workspace": "y", "quiet": True, "because": None}
