# SPDX-License-Identifier: Apache-2.0
"""Makes click commands of the functions that carry out verbs."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import click

from keymint.command_line.options import common_options, require_known_plugins
from keymint.errors import ExitCode, KeymintError
from keymint.output.report import Report
from keymint.run.run import Run, Setting
from keymint.workspace.shipped_profiles import UnacceptedPackagesError

Verb = Callable[..., Report]
"""The function of a verb; ``inspect.unwrap`` finds it below the callback of its click command."""


def verb(
    *,
    workspace: bool = True,
    jobs: bool = False,
    dry_run: bool = False,
    executor: bool = False,
    of: str = "",
    name: str = "",
) -> Callable[[Verb], click.Command]:
    """Return a decorator that makes a click command of a function ``(run, **options) -> Report``.

    The command adds the common options (see :func:`keymint.command_line.options.common_options`), shows the report or
    the error, and ends with the exit code. Its name is that of the function's module, without the name of the group and
    an underscore.

    Args:
        workspace: see :func:`keymint.command_line.options.common_options`, as for the next three.
        jobs: the verb writes several packages at a time.
        dry_run: the verb writes files.
        executor: the verb can compute in other processes.
        name: its name, if that is not the name of its module.
        of: the group of verbs that it belongs to, e.g. ``authority``; empty if it stands alone.
    """
    shared = list(common_options(workspace=workspace, jobs=jobs, dry_run=dry_run, executor=executor))
    names = {"jobs", *(option.name for option in shared)}  # 'check' declares --jobs itself

    def decorate(function: Verb) -> click.Command:
        module = function.__module__.rsplit(".", 1)[-1]
        own_name = name or module.removeprefix(f"{of}_")
        said = f"{of} {own_name}".strip()

        def command(context: click.Context, /, **options: Any) -> None:
            common = {key: options.pop(key) for key in list(options) if key in names}
            setting: Setting = context.find_root().obj()
            run = Run(setting, said, common)

            def work() -> Report:
                require_known_plugins(context, run.plugins)
                return function(run, **options)

            context.exit(int(_guarded(run, work)))

        functools.update_wrapper(command, function)
        made = click.command(own_name)(click.pass_context(command))
        made.params += shared
        return made

    return decorate


def _guarded(run: Run, function: Callable[[], Report]) -> ExitCode:
    """Run a verb, show its report or its error, and return the exit code."""
    try:
        report = function()
    except UnacceptedPackagesError as error:
        from keymint.command_line.accepted_packages import unaccepted_report  # noqa: PLC0415 - few runs need it

        report = unaccepted_report(run, error)
    except KeymintError as error:
        report = run.report({}, error.diagnostics, error.exit_code, workspace=run.known_workspace)
    run.console.show(run.presented(run.told(report)))
    return report.exit_code
