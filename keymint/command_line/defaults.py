# SPDX-License-Identifier: Apache-2.0
"""Defaults of options: by environment variables, by ``keymint.toml`` of the workspace, and by that of the user.

They may set what changes neither the meaning of a run nor its safety: :data:`SETTINGS`. Every other key of a file is an
error, and no variable gives another option a value, so a workspace from elsewhere, or a shell, switches nothing off.
"""

from __future__ import annotations

import itertools
import os
import re
import tomllib
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any

import click
from click.core import ParameterSource

from comarmor.errors import Diagnostic, Origin
from comarmor.text import did_you_mean, quote
from comarmor.values import dataclass
from keymint.errors import ExitCode, KeymintError
from keymint.output.console import COLOURS
from keymint.view.file_reading import read_file

MAX_BYTES = 1 << 16
"""Largest file of defaults that is read."""
_BUILT_IN, _ENVIRONMENT = "built-in", "environment"


@dataclass(frozen=True, slots=True)
class Settable:
    """An option that may have another default than the built-in one.

    Attributes:
        kind: the type of its values; None for that of the option, whose verb is imported only if it has a default.
        built_in: the built-in default, in words.
        verbs: the verbs that have the option; empty for all.
    """

    kind: click.ParamType[Any] | None
    built_in: str
    verbs: Collection[str] = ()


FORMATS: Mapping[str, Collection[str]] = {
    "diff": ("text", "markdown", "json"),
    "status": ("table", "openmetrics"),
}
"""The formats of the verbs that print in one of several."""
SETTINGS: Mapping[str, Settable] = {
    "color": Settable(click.Choice(COLOURS), "auto"),
    "format": Settable(click.Choice([*itertools.chain(*FORMATS.values())]), "text, table", FORMATS),
    "jobs": Settable(
        click.IntRange(1, 256),
        "all cores",
        ("build", "check", "create", "init", "install", "prove", "provision", "verify"),
    ),
    "quiet": Settable(click.BOOL, "false"),
    "threshold": Settable(None, "66%", ("renew",)),
    "verbose": Settable(click.IntRange(0, 9), "0"),
    "within": Settable(None, "0d", ("check",)),
}
"""What may be set, by the long name of the option."""


@dataclass(frozen=True, slots=True)
class Default:
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

    def is_for(self, verb: str) -> bool:
        """Tell whether a verb uses it, if its command line does not have the option.

        Args:
            verb: the words of the verb, e.g. ``authority show``.
        """
        first, verbs = verb.partition(" ")[0], SETTINGS[self.key].verbs
        is_value = self.key != "format" or self.value in FORMATS.get(first, ())
        return self.verb in ("", first, verb) and (not verbs or first in verbs) and is_value


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
    for name, value in variables:
        words = name.split("_")[1:]
        verb, key = " ".join(words[:-1]).lower(), words[-1].lower()
        known = SETTINGS[key].verbs or verbs
        # As for click, an empty variable is none.
        if value and (not verb or verb.partition(" ")[0] in known):
            found.append(Default(key, verb, value, _ENVIRONMENT, f"${name}"))
            problems += _problems(found[-1], value, None, group)
    for source, path in files.items():
        # Users keep their own files elsewhere and link to them; that of a workspace may be from a stranger.
        content = read_file(path if source == "workspace" else os.path.realpath(path), MAX_BYTES)
        if content is not None:
            own, wrong = _from_file(content, source, path, group)
            found += own
            problems += wrong
    if problems:
        raise KeymintError.of(problems, ExitCode.USAGE)
    # Of one source, what is said for a verb is stronger than what is said for all.
    order = [_ENVIRONMENT, *files]
    return tuple(sorted(found, key=lambda each: (order.index(each.source), -len(each.verb))))


def _from_file(content: bytes, source: str, shown: str, group: click.Group) -> tuple[list[Default], list[Diagnostic]]:
    """Return the defaults of a file, and what is wrong with it."""
    found: list[Default] = []
    problems: list[Diagnostic] = []
    try:
        text = content.decode()
        document = tomllib.loads(text)
    except UnicodeDecodeError as error:
        where = Origin(shown, content.count(b"\n", 0, error.start) + 1)
        return [], [Diagnostic.error("default-invalid", "is not UTF-8", where, "save it as UTF-8")]
    except (ValueError, RecursionError) as error:
        message, _, place = str(error).partition(" (at line ")
        line = int(place.partition(",")[0]) if place[:1].isdigit() else text.count("\n") + 1
        return [], [Diagnostic.error("default-invalid", f"is not TOML: {message}", Origin(shown, line), _EXAMPLE)]
    verbs = group.list_commands(click.Context(group))
    tables = {"": {key: value for key, value in document.items() if not isinstance(value, dict)}}
    for verb, table in document.items():
        if isinstance(table, dict):
            if verb in verbs:
                tables[verb] = table
            else:
                help_ = did_you_mean(verb, verbs, "a table has the name of a verb, e.g. [check]")
                where = Origin(shown, _line(text, verb, ""))
                problems.append(Diagnostic.error("default-unknown", f"there is no verb {quote(verb)}", where, help_))
    for verb, table in tables.items():
        for key, value in table.items():
            where = Origin(shown, _line(text, verb, key))
            settings = [name for name, each in SETTINGS.items() if not verb or not each.verbs or verb in each.verbs]
            if key not in settings:
                message = f"{quote(key)} {f'of [{verb}] ' if verb else ''}cannot be set here"
                help_ = f"{', '.join(settings)} can; anything else belongs on the command line"
                help_ = did_you_mean(key, settings, help_)
                problems.append(Diagnostic.error("default-unknown", message, where, help_))
                continue
            typed = int(value) if key == "verbose" and isinstance(value, bool) else value
            found.append(Default(key, verb, str(typed), source, str(where)))
            problems += _problems(found[-1], typed, where, group)
    return found, problems


_EXAMPLE = 'write e.g. jobs = 4, or for one verb [check] and below it within = "30d"'


def _problems(default: Default, value: object, where: Origin | None, group: click.Group) -> Iterator[Diagnostic]:
    """Yield what is wrong with a value."""
    setting = SETTINGS[default.key]
    kind = click.Choice(FORMATS[default.verb]) if default.key == "format" and default.verb else setting.kind
    if kind is None:
        verb = group.get_command(click.Context(group), next(iter(setting.verbs)))
        kind = next(each.type for each in verb.params if f"--{default.key}" in each.opts) if verb else click.STRING
    kinds = (str, {"quiet": bool, "jobs": int, "verbose": int}.get(default.key, str))
    problem = "" if type(value) in kinds else f"{quote(str(value))} is of another kind"
    try:
        kind.convert(str(value), None, None)
    except click.BadParameter as error:
        problem = problem or error.message.rstrip(".")
    if problem:
        message = f"{default.key if where else default.place}: {problem}"
        yield Diagnostic.error("default-invalid", message, where, f"write it as for --{default.key}")


def _line(text: str, table: str, key: str) -> int:
    """Return the line of a key in a file, or of the head of its table; the first one if it is not found."""
    found, inside = 1, not table
    name = re.compile(rf"""\s*(?:{re.escape(table)}\s*\.\s*)?["']?{re.escape(key)}["']?\s*[=.]""")
    for number, line in enumerate(text.splitlines(), 1):
        if head := re.match(r"""\s*\[+\s*["']?([^\]"']*?)["']?\s*\]""", line):
            inside = head[1].partition(".")[0].strip() == table
            found = number if inside and table else found
        elif key and name.match(line) and (inside or "." in line.partition("=")[0]):
            return number
    return found


def chosen_defaults(defaults: Sequence[Default], verb: str) -> Mapping[str, Default]:
    """Return the default of each setting for a verb; of ``quiet`` and ``verbose`` those of the strongest source."""
    chosen: dict[str, Default] = {}
    for each in defaults:
        other = chosen.get({"quiet": "verbose", "verbose": "quiet"}.get(each.key, ""))
        if each.is_for(verb) and (other is None or other.source == each.source):
            chosen.setdefault(each.key, each)
    return chosen


def with_defaults(context: click.Context, verb: str, defaults: Sequence[Default]) -> dict[str, Any]:
    """Return the values of options that the command line does not give, by the name of the parameter.

    Args:
        context: the context of the verb.
        verb: the words of the verb.
        defaults: all defaults.
    """
    chosen = dict(chosen_defaults(defaults, verb))
    keys = {option[2:]: each for each in context.command.params for option in each.opts if option.startswith("--")}
    typed = {
        key for key, each in keys.items()
        if context.get_parameter_source(each.name or "") is not ParameterSource.DEFAULT
    }  # fmt: skip
    if typed & {"quiet", "verbose"}:
        typed |= {"quiet", "verbose"}
    return {
        str(keys[key].name): keys[key].type_cast_value(context, each.value)
        for key, each in chosen.items()
        if key in keys and key not in typed
    }


def default_rows(defaults: Sequence[Default]) -> list[dict[str, Any]]:
    """Return what each setting is without an option, and where that comes from: for all verbs, and for single ones."""
    found = {(each.key, each.verb): each for each in reversed(defaults)}
    built_in = (Default(key, "", each.built_in, _BUILT_IN) for key, each in SETTINGS.items())
    every = {(each.key, ""): each for each in built_in} | found
    return [
        {"option": f"--{key}", "verb": verb or None, "value": each.value, "source": each.source,
         "place": each.place or None}
        for (key, verb), each in sorted(every.items())
    ]  # fmt: skip
