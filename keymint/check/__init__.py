# SPDX-License-Identifier: Apache-2.0
"""Compare the installed keystore with its expected state: ``keymint check``.

The build type checks the content of an enclave. This package checks the workspace: modes, the record of installed
files, unexpected files, authorities, and the files that all enclaves share.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from datetime import timedelta

from comarmor.errors import Diagnostic
from keymint.api import Inspection
from keymint.check.authorities import authorities, authority_keys, in_defect
from keymint.check.enclaves import identity_key, inspection, on_disk
from keymint.check.file_status import file_status
from keymint.check.git_exposure import git_exposure
from keymint.check.install_space import shared_files
from keymint.errors import KeymintError
from keymint.plan import identity_keys
from keymint.plan.enclaves import not_installed, unaccounted
from keymint.plan.identity_keys import Keyring
from keymint.session import Session


def check(session: Session, names: Sequence[str], within: timedelta) -> tuple[Diagnostic, ...]:
    """Return all findings on the enclaves of some packages, and on their workspace.

    Args:
        session: the workspace and its profile.
        names: names of packages.
        within: report what expires within this time.
    """
    of_authorities = tuple(authorities(session, within))
    keyring = Keyring(session, authority_keys(session))
    fingerprints: dict[str, str] = {}
    findings: list[Diagnostic] = []
    inspections: dict[str, list[Inspection]] = {}
    for name in names:
        try:
            package = session.package(name)
            seen, unread = inspection(session, package, within)
        except KeymintError as error:
            findings += error.diagnostics
            continue
        fingerprint, key_findings = identity_key(session, package, keyring)
        findings += key_findings
        if fingerprint:
            fingerprints[name] = fingerprint
        findings += unread
        if not seen.files and not unread:
            findings.append(not_installed(name, seen.folder))
            continue
        findings += on_disk(session, name, seen.files)
        defects = session.plugins.build_type(package.build_type, session.package_marker(package.name)).check(seen)
        unread_places = {each.where for each in unread}
        findings += (each for each in defects if each.code != "file-missing" or each.where not in unread_places)
        inspections.setdefault(package.build_type, []).append(seen)
    for build_type, of_type in sorted(inspections.items()):
        findings += session.plugins.build_type(build_type).check_all(of_type)
    findings += unaccounted(session)
    findings += identity_keys.shared_keys(session, fingerprints)
    findings += shared_files(session)
    later = _without_install_hints(findings, in_defect(of_authorities))
    return (*of_authorities, *file_status(session), *git_exposure(session), *later)


def _without_install_hints(findings: Iterable[Diagnostic], defect: Diagnostic | None) -> Iterator[Diagnostic]:
    """Yield findings without the hint to install, if a defect of an authority must be fixed first."""
    for finding in findings:
        installs = defect is not None and _INSTALLS.search(finding.help)
        yield replace(finding, help=f"fix {defect.where} first") if installs and defect else finding


_INSTALLS = re.compile(r"'keymint (install|provision)")
