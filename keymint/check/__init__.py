# SPDX-License-Identifier: Apache-2.0
"""Compare the installed keystore with its expected state: ``keymint check``.

The build type checks the content of an enclave. This package checks the workspace: modes, the record of installed
files, unexpected files, authorities, and the files that all enclaves share.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from datetime import timedelta

from comarmor.errors import Diagnostic, Severity
from keymint.api import Inspection
from keymint.check import revocations
from keymint.check.authorities import authorities, authority_keys, in_defect
from keymint.check.enclaves import identity_key, inspections, on_disk, unexpected
from keymint.check.file_status import file_status
from keymint.check.git_exposure import git_exposure
from keymint.check.install_space import outside_enclaves
from keymint.check.shared_documents import check_shared
from keymint.errors import KeymintError
from keymint.names import subject_of
from keymint.plan import identity_keys
from keymint.plan.enclaves import enclave_files, not_installed, unaccounted
from keymint.plan.identity_keys import Keyring
from keymint.plan.policy import is_unchanged, load_policy
from keymint.plan.register import withdrawn
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
    by_type: dict[str, list[Inspection]] = {}
    render = _renderer(session, names)
    for name in names:
        try:
            render(name)
            package = session.package(name)
            files, unreadable = enclave_files(session, name)
            seen = inspections(session, package, files, within)
        except KeymintError as error:
            findings += error.diagnostics
            continue
        fingerprint, key_findings = identity_key(session, package, keyring)
        findings += key_findings
        if fingerprint:
            fingerprints[name] = fingerprint
        unread = [each for each in unreadable if each.code != "symlink-refused"]  # reported with the modes
        findings += unread
        if not files and not unread:
            findings.append(_absent(session, name))
            continue
        findings += on_disk(session, name, files)
        findings += unexpected(session, package, files)
        findings += revocations.of_enclave(session, package, files)
        unread_places = {each.where for each in unread}
        defects = dict.fromkeys(each for build_type, own in seen.values() for each in build_type.check(own))
        findings += (each for each in defects if each.code != "file-missing" or each.where not in unread_places)
        for build_type, (_, own) in seen.items():
            by_type.setdefault(build_type, []).append(own)
    for build_type, of_type in sorted(by_type.items()):
        findings += session.plugins.build_type(build_type).check_all(of_type)
    findings += unaccounted(session)
    findings += revocations.lists_in_force(session)
    findings += identity_keys.shared_keys(session, fingerprints)
    shared = check_shared(session, within)
    findings += shared.diagnostics
    findings += outside_enclaves(session, shared.files)
    later = _without_install_hints(findings, in_defect(of_authorities))
    return (*of_authorities, *file_status(session), *git_exposure(session), *later)


def _absent(session: Session, name: str) -> Diagnostic:
    """Return the finding on a package without an enclave."""
    reason = withdrawn(session).get(name)
    if reason is None:
        return not_installed(name, session.workspace.shown(session.enclave_folder(name)))
    message = f"the certificate of {subject_of(name)} was revoked ({reason}), and its enclave removed"
    help_ = f"'keymint renew --rekey {name}' makes a new key and certificate"
    return Diagnostic("identity-revoked", Severity.NOTE, message, None, help_, subject_of(name))


def _renderer(session: Session, names: Sequence[str]) -> Callable[[str], object]:
    """Return what renders the sources of a package from the policy: such sources need not be parsed when it is loaded.

    It does nothing for a few packages of many, and if the policy is not the one that they were created from.
    """
    try:
        policy = load_policy(session) if len(names) == len(session.packages()) and is_unchanged(session) else None
    except KeymintError:  # reported with the policy
        policy = None

    def render(name: str) -> None:
        rules = policy.rules(subject_of(name)) if policy else None
        if rules:
            session.package_type.create(session.profile, rules, {}, force=False)

    return render


def _without_install_hints(findings: Iterable[Diagnostic], defect: Diagnostic | None) -> Iterator[Diagnostic]:
    """Yield findings without the hint to install, if a defect of an authority must be fixed first."""
    for finding in findings:
        installs = defect is not None and _INSTALLS.search(finding.help)
        yield replace(finding, help=f"fix {defect.where} first") if installs and defect else finding


_INSTALLS = re.compile(r"'keymint (install|provision)")
