"""Holds what is installed against what it should be: ``keymint check``.

What concerns the content of an enclave is judged by its build type. Here is what concerns the workspace: modes,
the record of what was installed, files that nobody accounts for, authorities, and what all enclaves share.
"""

from __future__ import annotations

from collections.abc import Sequence
from datetime import timedelta

from keymint.api import Inspection
from keymint.check.authorities import authorities
from keymint.check.enclaves import inspection, on_disk
from keymint.check.install_space import shared
from keymint.errors import Diagnostic, KeymintError, Origin, Severity
from keymint.plan import install
from keymint.plan.inputs import Inputs, LoadedProfile, Sources


def check(
    inputs: Inputs, loaded: LoadedProfile, names: Sequence[str], sources: Sources, within: timedelta
) -> tuple[Diagnostic, ...]:
    """Return all findings on some packages' enclaves, and on the workspace that they come from.

    Args:
        inputs: the workspace.
        loaded: its profile.
        names: names of packages.
        sources: the packages' files.
        within: report what expires within this time.
    """
    findings: list[Diagnostic] = list(authorities(inputs, loaded, within))
    inspections: dict[str, list[Inspection]] = {}
    for name in names:
        try:
            files = sources.files(inputs, name)
            package = sources.load(inputs, loaded, name, files)
            seen = inspection(inputs, loaded, package, within)
        except KeymintError as error:
            findings += error.diagnostics
            continue
        if not seen.files:
            findings.append(
                Diagnostic(
                    "enclave-missing",
                    Severity.ERROR,
                    f"the enclave /{name} is not installed",
                    Origin(seen.folder),
                    f"run 'keymint install {name}'",
                    f"/{name}",
                )
            )
            continue
        findings += on_disk(inputs, loaded, name, seen.files)
        findings += inputs.plugins.build_type(package.build_type, inputs.package_marker(package.name)).check(seen)
        inspections.setdefault(package.build_type, []).append(seen)
    for build_type, together in sorted(inspections.items()):
        findings += inputs.plugins.build_type(build_type).check_all(together)
    findings += (install.orphan_finding(name) for name in install.orphans(inputs, loaded))
    findings += shared(inputs, loaded)
    return tuple(findings)
