# SPDX-License-Identifier: Apache-2.0
"""``keymint plugins``: the installed plugins, and whether they load."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from comarmor.errors import Diagnostic
from comarmor.text import quote
from comarmor.xml.package_folders import SEARCH_PATH, InstalledPackages
from comarmor.xml.sandboxed_paths import path_text
from keymint.command_line.verb import Report, Run, verb
from keymint.errors import ExitCode, KeymintError


@verb(workspace=False)
def plugins(run: Run) -> Report:
    """List the installed plugins: group, name, version, distribution, and whether each loads.

    Then the ROS packages of AMENT_PREFIX_PATH that ship profiles, which policies include as package://PACKAGE/FILE.xml.
    """
    diagnostics: list[Diagnostic] = []
    listed: list[dict[str, Any]] = []
    for info in run.plugins.infos:
        usable = True
        try:
            run.plugins.load(info.group, info.name)
        except KeymintError as error:
            usable = False
            diagnostics += [diagnostic for diagnostic in error.diagnostics if diagnostic not in diagnostics]
        listed.append(asdict(info) | {"usable": usable})
    columns = {"GROUP": "group", "NAME": "name", "VERSION": "version", "DISTRIBUTION": "distribution"}
    run.console.table(columns | {"LOADS": "usable", "FROM": "location"}, listed)
    installed = InstalledPackages(run.setting.environment)
    packages = [
        {
            "name": each.name,
            "folder": path_text(str(each.folder)),
            "files": None if each.files is None else list(map(path_text, each.files)),
            "hidden_by": each.hidden_by or None,
        }
        for each in installed.shipping()
    ]
    if packages:
        run.console.line("")
        columns = {"PACKAGE": "name", "SHIPS": "ships", "HIDDEN BY": "hidden_by", "FROM": "from"}
        run.console.table(columns, [each | _shown(run, each) for each in packages])
    result = {"plugins": listed, "packages": packages}
    exit_code = ExitCode.FAILURE if diagnostics else ExitCode.DONE
    return run.report(result, [*diagnostics, *map(_relative, installed.relative_prefixes)], exit_code)


def _shown(run: Run, package: Mapping[str, Any]) -> dict[str, str]:
    files = package["files"]
    ships = "(unreadable)" if files is None else " ".join(files) or " "  # an empty list is no missing one
    return {"ships": ships, "from": run.typed(package["folder"])}


def _relative(prefix: str) -> Diagnostic:
    message = f"{SEARCH_PATH} has the relative path {quote(prefix, 200)}: what packages ship is not looked up there"
    help_ = (
        "write an absolute path; policies that include what a package ships there, or in a later prefix, are refused"
    )
    return Diagnostic.warning("package-prefix", message, None, help_)
