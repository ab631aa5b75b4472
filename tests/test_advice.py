# SPDX-License-Identifier: Apache-2.0
"""What messages and documents tell people to type exists: each verb, each option, and each option on its verb."""

from __future__ import annotations

import ast
import functools
import re
import shlex
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

import click
import pytest

from keymint.cli import VERBS, cli

CHECKOUT = Path(__file__).resolve().parent.parent
SOURCES = sorted(path for room in ("comarmor", "keymint", "plugins") for path in (CHECKOUT / room).rglob("*.py"))
DOCUMENTS = [*CHECKOUT.glob("*.md"), *(CHECKOUT / "docs").glob("*.md"), *(CHECKOUT / "docs/adr").glob("*.md")]
CONSEQUENTIAL = ("--rekey", "--prune", "--new-authority")
"""Options that replace or remove something for good: advice names them with their verb only."""

COMMAND = re.compile(r"(?<![\w/.-])keymint +(?P<verb>[a-z]+)(?P<rest>[^'`\n;&|)#]*)")
OPTION = re.compile(r"(?<![\w/-])--[a-z][a-z0-9-]+\b(?!=)")


def options_of(group: click.Group = cli, verbs: Iterable[str] = VERBS, above: str = "") -> Mapping[str, frozenset[str]]:
    """Return the options of each verb, of ``authority show`` as well."""
    context = click.Context(group)
    found: dict[str, frozenset[str]] = {}
    for verb in verbs:
        command = group.get_command(context, verb)
        assert command is not None
        named = {name for each in command.params for name in (*each.opts, *each.secondary_opts)}
        found[above + verb] = frozenset({*named, "--help", "-h"})
        if isinstance(command, click.Group):
            found |= options_of(command, command.list_commands(context), f"{verb} ")
    return found


OPTIONS = options_of()
EVERY_OPTION = frozenset().union(*OPTIONS.values()) | {"--version"}


@functools.cache
def told() -> tuple[tuple[Path, int, str], ...]:
    """Return the texts of all modules, each with its place."""
    return tuple((path, line, text) for path in SOURCES for line, text in sentences(path.read_text(encoding="utf-8")))


def sentences(source: str) -> Iterator[tuple[int, str]]:
    """Yield the texts of a module that people read: strings of several words, with X for what is filled in."""
    parents = {child: node for node in ast.walk(ast.parse(source)) for child in ast.iter_child_nodes(node)}
    for node, parent in parents.items():
        if isinstance(node, ast.JoinedStr):
            text = "".join(str(part.value) if isinstance(part, ast.Constant) else "X" for part in node.values)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and not isinstance(parent, ast.JoinedStr):
            text = node.value
        else:
            continue
        if " " in text.strip():
            yield node.lineno, text


def wrong(text: str) -> Iterator[str]:
    """Yield what a text tells people to type that does not exist."""
    for command in COMMAND.finditer(text):
        verb = command["verb"]
        if verb not in VERBS:
            if OPTION.search(command["rest"]) or text[: command.start()].endswith(("'", "`", "$ ")):
                yield f"no verb {verb!r}"
            continue
        try:
            words = shlex.split(command["rest"].split("  ")[0])
        except ValueError:
            words = command["rest"].split()
        if words and any(each.startswith(f"{verb} ") for each in OPTIONS):
            verb = f"{verb} {words.pop(0)}"
            if verb not in OPTIONS:
                yield f"no verb {verb!r}"
                continue
        for word in words:
            option = re.match(r"--?[a-z][a-z0-9-]*", word)
            if option and option[0] not in OPTIONS[verb]:
                yield f"no {option[0]} of {verb!r}"
    yield from (f"no {option}" for option in OPTION.findall(text) if option not in EVERY_OPTION)


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("'keymint isntall' does it", ["no verb 'isntall'"]),
        ("mint it with 'keymint install --renew'", ["no --renew of 'install'", "no --renew"]),
        ("mint it with --renow", ["no --renow"]),
        ("'keymint build --rekey X', or restore it", []),
        ("'keymint build -f X' discards it", []),
        ("'keymint build -x X' discards it", ["no -x of 'build'"]),
        ("'keymint authority renew X --flag-day' does it", []),
        ("'keymint authority renew X --vendor' does it", ["no --vendor of 'authority renew'"]),
        ("'keymint authority shaw X' shows it", ["no verb 'authority shaw'"]),
        ("Waiting for the workspace lock held by another keymint process (process 7)", []),
    ],
)
def test_what_does_not_exist_is_seen(text: str, found: list[str]) -> None:
    assert list(wrong(text)) == found


@pytest.mark.xdist_group("advice")  # one worker, so that the sources are parsed once
def test_every_piece_of_advice_in_the_sources_exists() -> None:
    seen = 0
    found = []
    for path, line, text in told():
        seen += len(COMMAND.findall(text)) + len(OPTION.findall(text))
        found += [f"{path.relative_to(CHECKOUT)}:{line}: {what}" for what in wrong(text) if not _is_foreign(text)]
    assert found == []
    assert seen > 100


@pytest.mark.xdist_group("advice")
def test_no_advice_leaves_open_which_verb_replaces_or_removes_something() -> None:
    bare = re.compile(rf"(?<!\w)(?<!build )(?<!install )({'|'.join(CONSEQUENTIAL)})\b")
    found = [
        f"{path.relative_to(CHECKOUT)}:{line}: {text}"
        for path, line, text in told()
        if "commands" not in path.parts and bare.search(COMMAND.sub("", text))
    ]
    assert found == []


def _is_foreign(text: str) -> bool:
    """Tell whether a text is about another program."""
    return bool(re.search(r"ros2 run|openssl |git |uv |pip |pipx |rosdep |colcon build |pkcs11-tool ", text))


def test_every_command_in_the_documents_exists() -> None:
    seen = 0
    found = []
    for path in DOCUMENTS:
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
            for command in COMMAND.finditer(line):
                seen += 1
                found += [f"{path.name}:{number}: {what}" for what in wrong(command[0]) if what.startswith("no -")]
    assert found == []
    assert seen > 50
