# SPDX-License-Identifier: Apache-2.0
"""``keymint plugins``: the installed plugins, and whether they load."""

from __future__ import annotations

from dataclasses import asdict

from comarmor.errors import Diagnostic
from keymint.commands.run import Run
from keymint.commands.verb import verb
from keymint.errors import ExitCode, KeymintError
from keymint.output.report import Report


@verb(workspace=False)
def plugins(run: Run) -> Report:
    """List the installed plugins: group, name, version, distribution, and whether each loads."""
    diagnostics: list[Diagnostic] = []
    listed = []
    for info in run.plugins.infos:
        usable = True
        try:
            run.plugins.load(info.group, info.name)
        except KeymintError as error:
            usable = False
            diagnostics += [diagnostic for diagnostic in error.diagnostics if diagnostic not in diagnostics]
        listed.append((info, usable))
    run.console.table(
        ["GROUP", "NAME", "VERSION", "DISTRIBUTION", "LOADS", "FROM"],
        [
            [info.group, info.name, info.version, info.distribution, "yes" if usable else "no", info.location]
            for info, usable in listed
        ],
    )
    result = {"plugins": [asdict(info) | {"usable": usable} for info, usable in listed]}
    return Report(run.verb, None, (), diagnostics, result, ExitCode.FAILURE if diagnostics else ExitCode.DONE)
