# SPDX-License-Identifier: Apache-2.0
"""Defaults of options: by environment variables, by ``keymint.toml`` of the workspace, and by that of the user.

They may set what changes neither the meaning of a run nor its safety: :data:`SETTINGS`. Every other key of a file is an
error, and no variable gives another option a value, so a workspace from elsewhere, or a shell, switches nothing off.
"""

from __future__ import annotations

import os
import re
import tomllib
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import click
from click.core import ParameterSource

from comarmor.text import did_you_mean, quote
from keymint.errors import Diagnostic, ExitCode, KeymintError, Origin
from keymint.view.file_reading import read_file

MAX_BYTES = 1 << 16
"""Largest file of defaults that is read."""
_WRITERS = ("build", "check", "create", "init", "install", "prove", "provision", "report", "verify")
SETTINGS: Mapping[str, tuple[str, Collection[str]]] = {
    "color": ("auto", ()),
    "format": ("text, table", ("diff", "status")),
    "jobs": ("all cores", _WRITERS),
    "quiet": ("false", ()),
    "threshold": ("66%", ("renew",)),
    "verbose": ("0", ()),
    "within": ("0d", ("check",)),
}
"""What may be set, by the long name of the option: the built-in default in words, and the verbs (empty for all)."""
_NO_TEXT = {"jobs": "4", "quiet": "true", "verbose": "1"}
"""What a file sets without quotes, each with an example."""


class Default(NamedTuple):
    """The default of an option.

    Attributes:
        key: the long name of the option.
        verb: the verb that it is for; empty for all.
        value: the value, as on the command line.
        source: ``environment``, ``workspace``, ``user`` or ``built-in``.
        place: the variable, the file with its line, or an empty text.
    """

    key: str
    verb: str
    value: str
    source: str
    place: str = ""


def load_defaults(
    variables: Sequence[tuple[str, str]], files: Mapping[str, str], group: click.Group
) -> tuple[Default, ...]:
    """Return all defaults, the strongest first.

    Args:
        variables: the environment variables whose names end like a setting.
        files: the files by ``workspace`` and ``user``, the stronger one first, each with its absolute path.
        group: the verbs.

    Raises:
        KeymintError: a file cannot be read, has another key, or a value is wrong; a usage error.
    """
    found: list[Default] = []
    problems: list[Diagnostic] = []
    verbs = group.list_commands(click.Context(group))
    # A variable for one verb has a longer name, and is stronger than one for all verbs.
    for name, value in sorted(variables, key=lambda each: -len(each[0])):
        *words, key = name.lower().split("_")[1:]
        # As for click, an empty variable is none.
        if value and (not words or words[0] in (SETTINGS[key][1] or verbs)):
            found.append(Default(key, " ".join(words), value, "environment", f"${name}"))
            problems += _wrong_value(found[-1], None, group)
    for source, path in files.items():
        # Users keep their own files elsewhere and link to them; that of a workspace may be from a stranger.
        content = read_file(path if source == "workspace" else os.path.realpath(path), MAX_BYTES) or b""
        try:
            text = content.decode()
            entries = tomllib.loads(text)
        except (ValueError, RecursionError) as error:
            problems.append(_unreadable(error, content, path))
            continue
        for key, given in entries.items():
            where = Origin(path, _line(text, key))
            if key in _NO_TEXT and isinstance(given, str):
                help_ = f"write it without quotes, e.g. {key} = {_NO_TEXT[key]}"
                message = f"{key}: {quote(given)} is a text"
                problems.append(Diagnostic.error("default-invalid", message, where, help_))
            elif key in SETTINGS:
                value = str(int(given) if key == "verbose" and isinstance(given, bool) else given)
                found.append(Default(key, "", value, source, str(where)))
                problems += _wrong_value(found[-1], where, group)
            else:
                help_ = did_you_mean(key, SETTINGS, f"{', '.join(SETTINGS)} can; all else belongs on the command line")
                message = f"{quote(key)} cannot be set here"
                problems.append(Diagnostic.error("default-unknown", message, where, help_))
    if problems:
        raise KeymintError.of(problems, ExitCode.USAGE)
    return tuple(found)


def _unreadable(error: Exception, content: bytes, path: str) -> Diagnostic:
    """Return what is wrong with the text of a file."""
    place = re.search(r" \(at line ([0-9]+)", str(error))
    line = int(place[1]) if place else content.count(b"\n", 0, getattr(error, "start", len(content))) + 1
    message = f"is not {'UTF-8' if isinstance(error, UnicodeDecodeError) else 'TOML'}: {error}"
    example = 'write e.g. jobs = 4, or within = "30d"'
    return Diagnostic.error("default-invalid", message, Origin(path, line), example)


def _wrong_value(default: Default, where: Origin | None, group: click.Group) -> Iterator[Diagnostic]:
    """Yield what is wrong with a value, of which one verb at least must take it."""
    problem, verbs = "", SETTINGS[default.key][1] or ("status",)
    for verb in [default.verb] if default.verb in verbs else verbs:
        command = group.get_command(click.Context(group), verb)
        try:
            for each in command.params if command else ():
                if f"--{default.key}" in each.opts:
                    each.type.convert(default.value, each, None)
        except click.BadParameter as error:
            problem = error.message.rstrip(".")
        else:
            return
    message = f"{default.key if where else default.place}: {problem}"
    yield Diagnostic.error("default-invalid", message, where, f"write it as for --{default.key}")


def _line(text: str, key: str) -> int:
    """Return the line of a key, or of a table of this name, in a file; the first one if it is not found."""
    begin = re.compile(rf"""\s*\[*\s*["']?{re.escape(key)}\b""")
    return next((number for number, line in enumerate(text.splitlines(), 1) if begin.match(line)), 1)


def with_defaults(context: click.Context, verb: str, defaults: Sequence[Default]) -> dict[str, Any]:
    """Return the values of options that the command line does not give, by the name of the parameter.

    Args:
        context: the context of the verb.
        verb: the words of the verb.
        defaults: all defaults.
    """
    first = verb.partition(" ")[0]
    options = {name[2:]: each for each in context.command.params for name in each.opts if name.startswith("--")}
    sources = {key: context.get_parameter_source(str(each.name)) for key, each in options.items()}
    typed = {key for key, source in sources.items() if source is not ParameterSource.DEFAULT}
    chosen: dict[str, Default] = {}
    for each in defaults:
        # Of 'quiet' and 'verbose' only the strongest source counts.
        other = {"quiet": "verbose", "verbose": "quiet"}.get(each.key, each.key)
        is_for_verb = each.verb in ("", first, verb) and first in (SETTINGS[each.key][1] or (first,))
        is_strongest = chosen.get(other, each).source == each.source and typed.isdisjoint((each.key, other))
        if is_for_verb and is_strongest and each.value in getattr(options[each.key].type, "choices", (each.value,)):
            chosen.setdefault(each.key, each)
    return {str(options[key].name): options[key].type_cast_value(context, each.value) for key, each in chosen.items()}


def default_rows(defaults: Sequence[Default]) -> list[dict[str, Any]]:
    """Return what each setting is without an option, and where that comes from: for all verbs, and for single ones."""
    built_in = [Default(key, "", value, "built-in") for key, (value, _) in SETTINGS.items()]
    every = {each[:2]: each._asdict() for each in (*built_in, *reversed(defaults))}
    return [
        {"option": f"--{key}", **{name: own[name] or None for name in ("verb", "value", "source", "place")}}
        for (key, _), own in sorted(every.items(), key=lambda item: item[0])
    ]
