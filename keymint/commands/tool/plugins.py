# SPDX-License-Identifier: Apache-2.0
"""``keymint plugins``: the installed plugins, and whether they load."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from comarmor.text import quote
from comarmor.xml.package_folders import SEARCH_PATH, InstalledPackages
from comarmor.xml.sandboxed_paths import path_text
from keymint.command_line.verb import Report, Run, verb
from keymint.errors import Diagnostic, ExitCode, KeymintError


@verb(workspace=False)
def plugins(run: Run) -> Report:
    """List the installed plugins: group, name, version, distribution, and whether each loads.

    Also lists the ROS packages in AMENT_PREFIX_PATH that ship profiles; policies include these as
    package://PACKAGE/FILE.xml.
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
    packages: list[dict[str, Any]] = [
        {
            "name": name,
            "folder": path_text(str(folder)),
            "files": None if files is None else list(map(path_text, files)),
            "hidden_by": hidden_by or None,
        }
        for name, folder, files, hidden_by in installed.shipping()
    ]
    if packages:
        run.console.line("")
        columns = {"PACKAGE": "name", "SHIPS": "ships", "HIDDEN BY": "hidden_by", "FROM": "from"}
        rows = []
        for each in packages:
            files = each["files"]
            ships = "(unreadable)" if files is None else " ".join(files) or " "  # an empty list is no missing one
            rows.append(each | {"ships": ships, "from": run.typed(each["folder"])})
        run.console.table(columns, rows)
    exit_code = ExitCode.FAILURE if diagnostics else ExitCode.DONE
    for prefix in (each for each in installed.prefixes if not each.startswith("/")):
        message = f"{SEARCH_PATH} has the relative path {quote(prefix, 200)}: what packages ship is not looked up there"
        refused = "policies that include what a package ships there, or in a later prefix, are refused"
        diagnostics.append(Diagnostic.warning("package-prefix", message, None, f"write an absolute path; {refused}"))
    return run.report({"plugins": listed, "packages": packages}, diagnostics, exit_code)
