# SPDX-License-Identifier: Apache-2.0
"""What a verb consists of: it makes click commands of functions from a run and options to a report.

Each argument of such a function says by its default what the command line has for it: ``output: Path | None =
option("-o", type=FILE)`` is an option ``-o/--output`` with its value, named once. What the help page says about it
stands in the part ``Options:`` of the function's docstring; the other parts are the begin of the help page.
"""

from __future__ import annotations

import functools
import inspect
import os
from collections.abc import Callable, Iterator, Mapping
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from typing import Any, cast

import click
from click.core import ParameterSource

from comarmor.values import Data, defaults_of, replace
from keymint import SPACES
from keymint.api.plugin_loader import Plugins
from keymint.command_line.verb_group import VerbCommand, help_all
from keymint.errors import Diagnostic, KeymintError
from keymint.output.console import COLOURS
from keymint.output.report import Report, findings_exit, findings_if
from keymint.run.run import Run, Setting
from keymint.view.recorded_answers import DEFAULTS_FILE
from keymint.workspace.shipped_profiles import UnacceptedPackagesError
from keymint.workspace.workspace import PROFILE_MARKER

__all__ = [
    "FILE", "PATH", "OptionGroup", "Report", "Run", "Word", "argument", "findings_exit",
    "findings_if", "flag", "option", "option_group", "parameters_of", "path_option", "plugin", "verb",
]  # fmt: skip
Verb = Callable[..., Report]
"""The function of a verb; ``inspect.unwrap`` finds it below the callback of its click command."""
_Declared = tuple[
    list[click.Parameter], "Mapping[str, OptionGroup]", list[tuple[click.Option, click.Option]], set[str | None]
]
"""All parameters of a verb, groups of options, options with their former names, and the names of the common ones."""
PATH = click.Path(path_type=Path)
FILE = click.Path(path_type=Path, dir_okay=False)
_CHOSEN_BY_USERS = {"keymint.build_types", "keymint.transports"}
"""The groups of plugins of which most users choose one."""
_MARKER = f"profile/{PROFILE_MARKER}"


def verb(
    *, of: str = "", name: str = "", former: Mapping[str, str] = MappingProxyType({}), **common: bool
) -> Callable[[Verb], click.Command]:
    """Return a decorator that makes a click command of a function ``(run, **options) -> Report``.

    The defaults of the function's arguments are its options. The command adds the common options, shows the report or
    the error, and ends with the exit code. Its name is that of the function, without the name of the group and an
    underscore.

    Args:
        of: the group of verbs that it belongs to, e.g. ``authority``; empty if it stands alone.
        name: its name, if that is not the name of the function.
        former: the names that options had in the release before, by the arguments of the function.
        common: which common options it has; see :func:`common_options`.
    """

    def decorate(function: Verb) -> click.Command:
        own_name = name or function.__name__.removeprefix(f"{of}_")
        said = f"{of} {own_name}".strip()

        @functools.cache  # a verb may import another one, whose options nobody asks for then
        def declared() -> _Declared:
            parameters, groups = parameters_of(function)
            own: Mapping[Any, Any] = {each.name: each for each in parameters}
            renamed = [(own[now], _former(own[now], names)) for now, names in former.items()]
            shared = list(common_options(**common))
            every = [*parameters, *shared, *(before for _, before in renamed)]
            has_hidden = any(isinstance(each, click.Option) and each.hidden for each in every)
            every.append(help_all(hidden=not has_hidden))
            return every, groups, renamed, {"defaults", *(option.name for option in shared)}

        def command(context: click.Context, /, **options: Any) -> None:
            setting: Setting = context.find_root().obj()
            _, groups, renamed, names = declared()
            defaults, problem = _defaults(context, setting, said)
            options |= defaults
            common = {key: options.pop(key) for key in list(options) if key in names}
            hints = tuple(_renamed(context, options, now, before) for now, before in renamed)
            options |= {key: group.taken(options) for key, group in groups.items()}
            run = Run(setting, said, common)
            try:
                if problem:
                    raise problem
                require_known_plugins(context, run.plugins)
                report = function(run, **options)
            except UnacceptedPackagesError as error:
                report = _in_result_files(run, options, _unaccepted_report(run, error))
            except KeymintError as error:
                report = run.report(run.result, error.diagnostics, error.exit_code, workspace=run.known_workspace)
                report = _in_result_files(run, options, report)
            report = replace(report, diagnostics=(*report.diagnostics, *filter(None, hints)))
            run.console.show(run.presented(run.told(report)))
            context.exit(int(report.exit_code))

        functools.update_wrapper(command, function)
        command.__doc__ = option_texts(function)[0]
        make = click.command(own_name, cls=VerbCommand, declared=lambda: declared()[0])
        return make(click.pass_context(command))

    return decorate


def _former(now: click.Option, names: str) -> click.Option:
    """Return an option that does what another one does, by the names that it had before; no help page has it."""
    before = object.__new__(type(now))
    changes = {"name": f"former_{now.name}", "opts": names.split(), "hidden": True, "help": None}
    vars(before).update(vars(now) | changes)
    return before


def _renamed(
    context: click.Context, options: dict[str, Any], now: click.Option, before: click.Option
) -> Diagnostic | None:
    """Move the value of an option that was given by its former name, and return a hint; None if it was not given."""
    value = options.pop(str(before.name))
    if context.get_parameter_source(str(before.name)) is not ParameterSource.COMMANDLINE:
        return None
    options[str(now.name)] = (*options[str(now.name)], *value) if isinstance(value, tuple) else value
    message = f"the option {'/'.join(before.opts)} is called {now.opts[-1]} now"
    return Diagnostic.warning("option-renamed", message, None, "use the new name: the next release has no other")


def _defaults(context: click.Context, setting: Setting, verb: str) -> tuple[dict[str, Any], KeymintError | None]:
    """Return the values of options that variables and files of defaults set, and what is wrong with these."""
    color = context.find_root().params.get("color")
    before = {"color": color} if color and not context.params.get("color") else {}
    start = os.path.realpath(setting.cwd / (context.params.get("workspace") or "."))
    roots = (folder for folder in (start, *map(str, Path(start).parents)) if os.path.lexists(f"{folder}/{_MARKER}"))
    places = {"workspace": f"{next(roots, start)}/{DEFAULTS_FILE}", "user": setting.call.user_defaults}
    files = {source: file for source, file in places.items() if os.path.lexists(file)}
    if not setting.call.variables and not files:
        return before, None
    from keymint.command_line.defaults import load_defaults, with_defaults  # noqa: PLC0415 - few users have any

    try:
        group = cast("click.Group", context.find_root().command)
        defaults = load_defaults(setting.call.variables, files, group)
        return with_defaults(context, verb, defaults) | before | {"defaults": defaults}, None
    except KeymintError as error:
        return before, error


def _in_result_files(run: Run, options: Mapping[str, Any], report: Report) -> Report:
    """Write the errors of a verb to the files of results that the user named: none of an earlier run stays there."""
    for kind in ("sarif", "junit"):
        if path := options.get(kind):
            from keymint.command_line.named_files import write_errors  # noqa: PLC0415 - few runs have such a file

            report = write_errors(run, path, kind, report)
    return report


def _unaccepted_report(run: Run, error: UnacceptedPackagesError) -> Report:
    """Return the report of a verb that met files of packages that nobody accepted, and show what they change."""
    # Few runs need the comparison, and it takes time to import.
    from keymint.analysis.policy_diff import diff_policies  # noqa: PLC0415
    from keymint.output.differences import as_text, differences_json, summary  # noqa: PLC0415

    files = [
        {"package": each.package, "path": each.path, "accepted": accepted or None, "shipped": each.sha256}
        for each, accepted in error.files.items()
    ]
    result: dict[str, object] = {"unaccepted": files, "subjects": None}
    diagnostics = error.diagnostics
    try:
        differences = diff_policies(error.before(), error.after)
    except KeymintError as reason:
        why = f"what that changes cannot be shown, since the accepted files do not fit the policy: {reason}"
        diagnostics = (*diagnostics, Diagnostic.warning("package-diff", why, None, "read the files"))
    else:
        run.console.lines((*as_text(differences, run.place), summary(differences)))
        result["subjects"] = differences_json(differences, run.typed)
    return run.report(result, diagnostics, error.exit_code, workspace=run.known_workspace)


# -- its own parameters ----------------------------------------------------------------------------------------------


class Word(click.types.StringParamType):
    """A text for which the shell is offered what exists; see :mod:`keymint.command_line.completion`.

    Args:
        group: the entry-point group of the plugins that it names; empty if it names none.
    """

    def __init__(self, group: str = "") -> None:
        self.group = group

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[Any]:
        """Return what the shell offers, as items of :mod:`click.shell_completion`."""
        found = import_module("keymint.command_line.completion").values(ctx, param, incomplete)
        return [import_module("click.shell_completion").CompletionItem(each) for each in found]


def require_known_plugins(context: click.Context, plugins: Plugins) -> None:
    """Require that each plugin that the command line names is installed.

    Raises:
        KeymintError: a plugin is not installed; the exit code is that of a usage error.
    """
    for parameter in context.command.params:
        kind, name = parameter.type, str(parameter.name)
        if isinstance(kind, Word) and kind.group and context.get_parameter_source(name) is ParameterSource.COMMANDLINE:
            value = context.params[name]
            for plugin in value if isinstance(value, tuple) else (value,):
                plugins.require(kind.group, plugin)


class OptionGroup(Data):
    """Options whose values reach a verb together, as one argument.

    Attributes:
        kind: data type of the argument.
        options: the option of each field that the command line gives, in the order of the help page.
        check: raises a usage error for values that exclude each other.
    """

    kind: type
    options: Mapping[str, Any]
    check: Callable[[Any], None]

    def taken(self, values: dict[str, Any]) -> Any:
        """Return the argument that the values of the options make, which are taken from all values."""
        made = self.kind(**{name: values.pop(name) for name in self.options})
        self.check(made)
        return made


def option(*names: str, **settings: Any) -> Any:
    """Return the default of an argument that an option gives.

    Args:
        names: its names; without a long one, the name of the argument.
        settings: as of :class:`click.Option`.
    """
    return functools.partial(_option, names, settings)


def flag(*names: str, **settings: Any) -> Any:
    """Return the default of an argument that is true if an option is given; see :func:`option`."""
    return option(*names, is_flag=True, **settings)


def path_option(*names: str, kind: click.Path = PATH, metavar: str = "FILE", **settings: Any) -> Any:
    """Return the default of an argument that names a file or a folder; see :func:`option`."""
    return option(*names, type=kind, metavar=metavar, **settings)


def plugin(group: str, *names: str, **settings: Any) -> Any:
    """Return the default of an argument that names a plugin of an entry-point group; see :func:`option`.

    Only authors of plugins choose among those of most groups: the help page shows these options if it is asked for all.
    """
    hidden = group not in _CHOSEN_BY_USERS
    return option(*names, type=Word(group), metavar="NAME", hidden=hidden, **settings)


def argument(**settings: Any) -> Any:
    """Return the default of an argument that the command line gives by its position; see :class:`click.Argument`."""
    return functools.partial(lambda name: click.Argument([name], **settings))


def option_group(kind: type, check: Callable[[Any], None] = lambda _: None, **options: Any) -> Any:
    """Return the default of an argument that several options give together.

    Args:
        kind: data type of the argument; its fields may have options as defaults.
        check: raises a usage error for values that exclude each other.
        options: options for further fields.
    """
    declared = {name: each for name, each in defaults_of(kind).items() if isinstance(each, functools.partial)}
    return OptionGroup(kind, {**declared, **options}, check)


def option_texts(declared: object) -> tuple[str, Mapping[str, str]]:
    """Return a docstring without its part ``Options:``, and the texts in that by their names."""
    page, _, listed = (inspect.getdoc(declared) or "").partition("\n\nOptions:\n")
    # The further lines of a text are deeper than its name.
    entries = (entry.partition(": ") for entry in listed.replace("\n     ", " ").splitlines())
    return page, {name.strip(): " ".join(text.split()) for name, _, text in entries}


def parameters_of(function: Callable[..., Any]) -> tuple[list[click.Parameter], Mapping[str, OptionGroup]]:
    """Return what the command line has for the arguments of a verb's function, in their order, and its groups."""
    found: list[click.Parameter] = []
    groups: dict[str, OptionGroup] = {}
    _, texts = option_texts(function)
    for each in inspect.signature(function).parameters.values():
        if isinstance(each.default, OptionGroup):
            groups[each.name] = each.default
            found += (made(name) for name, made in each.default.options.items())
            texts = {**option_texts(each.default.kind)[1], **texts}
        elif isinstance(each.default, functools.partial):
            found.append(each.default(each.name))
    for parameter in found:
        parameter.type = Word() if parameter.type is click.STRING else parameter.type
        if isinstance(parameter, click.Option):
            parameter.help = parameter.help or texts.get(str(parameter.name))
    return found, groups


def _option(names: tuple[str, ...], settings: Mapping[str, Any], name: str) -> click.Option:
    long = () if any(each.startswith("--") for each in names) else (f"--{name.replace('_', '-')}",)
    return click.Option([name, *names, *long], **settings)


# -- the options of all verbs ----------------------------------------------------------------------------------------


def common_options(
    *, workspace: bool = True, jobs: bool = False, dry_run: bool = False, processes: bool = False, yes: bool = False
) -> Iterator[click.Option]:
    """Yield the options that are not about what a verb does.

    Args:
        workspace: the verb may read or write a workspace.
        jobs: the verb writes several packages at a time.
        dry_run: the verb writes files.
        processes: the verb can compute in several processes.
        yes: the verb asks before it takes something away; see :meth:`keymint.run.run.Run.confirm`.
    """
    if workspace:
        yield click.Option(
            ["-w", "--workspace"],
            type=PATH,
            metavar="DIR",
            help="Workspace directory [the one that contains the current directory].",
        )
    yield click.Option(["--json", "as_json"], is_flag=True, help="Print one JSON document (docs/json.md).")
    yield click.Option(["--color"], type=click.Choice(COLOURS), help="Colours; auto: on a terminal [auto].")
    yield click.Option(["-v", "--verbose"], count=True, help="Show every step, file, message and note.")
    yield click.Option(["-q", "--quiet"], is_flag=True, help="Show errors only.")
    for space in SPACES if workspace else ():
        where = f"Directory of the {space} space [{space}/]."
        yield click.Option([f"--{space}-space"], type=PATH, metavar="DIR", hidden=True, help=where)
    if jobs or processes:
        what = "Write N packages at a time [all cores]." if jobs else "Use N processes [all cores]."
        yield click.Option(["-j", "--jobs"], type=click.IntRange(1, 256), metavar="N", help=what)
    if dry_run:
        yield click.Option(["--dry-run"], is_flag=True, help="Show what would change; write nothing.")
    if yes:
        yield click.Option(["--yes"], is_flag=True, help="Neither ask nor stop before something is taken away.")
