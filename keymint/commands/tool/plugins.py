# SPDX-License-Identifier: Apache-2.0
"""``keymint plugins``: the installed plugins, and whether they load."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from comarmor.errors import Diagnostic
from comarmor.text import quoted
from comarmor.xml.package_folders import SEARCH_PATH, InstalledPackages, ShippingPackage
from comarmor.xml.sandboxed_paths import path_text
from keymint.command_line.verb import verb
from keymint.errors import ExitCode, KeymintError
from keymint.output.report import Report
from keymint.run.run import Run


@verb(workspace=False)
def plugins(run: Run) -> Report:
    """List the installed plugins: group, name, version, distribution, and whether each loads.

    Then the ROS packages of AMENT_PREFIX_PATH that ship profiles, which policies include as package://PACKAGE/FILE.xml.
    """
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
    installed = InstalledPackages(run.setting.environment)
    shipping = tuple(installed.shipping())
    if shipping:
        run.console.line("")
        run.console.table(["PACKAGE", "SHIPS", "HIDDEN BY", "FROM"], [_row(run, each) for each in shipping])
    result = {
        "plugins": [asdict(info) | {"usable": usable} for info, usable in listed],
        "packages": [_document(each) for each in shipping],
    }
    exit_code = ExitCode.FAILURE if diagnostics else ExitCode.DONE
    return run.report(result, [*diagnostics, *map(_relative, installed.relative_prefixes)], exit_code)


def _row(run: Run, package: ShippingPackage) -> list[str]:
    files = "(unreadable)" if package.files is None else " ".join(package.files)
    return [package.name, files, package.hidden_by or "-", run.typed(path_text(str(package.folder)))]


def _document(package: ShippingPackage) -> dict[str, Any]:
    return {
        "name": package.name,
        "folder": path_text(str(package.folder)),
        "files": None if package.files is None else list(map(path_text, package.files)),
        "hidden_by": package.hidden_by or None,
    }


def _relative(prefix: str) -> Diagnostic:
    message = f"{SEARCH_PATH} has the relative path {quoted(prefix, 200)}: what packages ship is not looked up there"
    help_ = (
        "write an absolute path; policies that include what a package ships there, or in a later prefix, are refused"
    )
    return Diagnostic.warning("package-prefix", message, None, help_)
