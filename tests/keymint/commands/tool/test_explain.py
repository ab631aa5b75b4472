# SPDX-License-Identifier: Apache-2.0
"""``keymint explain`` says what each code means; that each has a text is a test of the codes."""

from __future__ import annotations

import re

import click

from keymint.cli import cli
from keymint.commands.tool.explain import PARTS
from keymint.output.explanations import explanations
from tests.conftest import CHECKOUT
from tests.keymint.commands.test_json import held

CODES = explanations()
_VERB = re.compile(r"'keymint ([a-z]+)([^']*)'")


def is_plain(text: str) -> bool:
    """Return whether a text is one to four lines of plain sentences."""
    begins, ends = text[0].isupper() or text[0] in "'-", text.endswith(".")
    return text.isprintable() and text.isascii() and len(text) <= 320 and begins and ends and "  " not in text


def test_texts_are_plain_and_complete() -> None:
    assert {code for code, texts in CODES.items() if tuple(texts) != PARTS} == set()
    assert [text for texts in CODES.values() for text in texts.values() if not is_plain(text)] == []


def verb_of(words: str) -> tuple[click.Command, str]:
    """Return the verb that some words call, and the words after it."""
    command: click.Command = cli
    context = click.Context(cli)
    rest = words.split()
    while isinstance(command, click.Group) and rest:
        found = command.get_command(context, rest[0])
        assert found is not None, words
        command, rest = found, rest[1:]
    return command, " ".join(rest)


def test_what_texts_advise_exists() -> None:
    texts = [text for of_code in CODES.values() for text in of_code.values()]
    for verb, rest in {found for text in texts for found in _VERB.findall(text)}:
        command, arguments = verb_of(f"{verb}{rest}")
        known = {name for each in command.params for name in each.opts} | {"--help"}
        assert set(re.findall(r"(?<!\S)--?[a-z][a-z0-9-]*", arguments)) <= known, f"{verb}{rest}"


def options_of(command: click.Command) -> set[str]:
    """Return the options of a verb, or of all verbs of a group."""
    names = command.list_commands(click.Context(command)) if isinstance(command, click.Group) else ()
    below = (command.get_command(click.Context(command), name) for name in names)  # type: ignore[union-attr]
    own = {name for each in command.params for name in (*each.opts, *each.secondary_opts)}
    return own.union(*(options_of(each) for each in below if each))


def test_options_and_pages_that_texts_name_exist() -> None:
    text = "\n".join(text for of_code in CODES.values() for text in of_code.values())
    assert set(re.findall(r"'(--?[a-z][a-z-]*)", text)) <= options_of(cli)
    assert [page for page in re.findall(r"docs/[a-z0-9-]+\.md", text) if not (CHECKOUT / page).is_file()] == []


def test_it_explains_codes(keymint) -> None:
    outcome = keymint("explain", "[grant-expired]", "usage")
    assert (outcome.code, outcome.err) == (0, "")
    assert outcome.out.startswith("grant-expired\n  cause:  A grant has expired.\n  effect: ")
    assert "\n\nusage\n  cause:  " in outcome.out
    assert max(map(len, outcome.out.splitlines())) <= 80
    codes = held(keymint("explain", "grant-expired", "--json"))["result"]["codes"]
    assert codes == [{"code": "grant-expired", **CODES["grant-expired"]}]


def test_without_a_code_it_lists_all(keymint) -> None:
    outcome = keymint("explain")
    assert [line.split()[0] for line in outcome.out.splitlines() if line[:1].strip()] == ["CODE", *CODES]
    assert len(held(keymint("explain", "--json"))["result"]["codes"]) == len(CODES)


def test_a_misspelt_code(keymint) -> None:
    outcome = keymint("explain", "grant-expird")
    assert outcome.code == 2
    assert outcome.err == "error: no code 'grant-expird' (did you mean 'grant-expired'?) [code-unknown]\n"
    assert "'keymint explain' lists the codes" in keymint("explain", "xyzzy").err
