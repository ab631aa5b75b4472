# SPDX-License-Identifier: Apache-2.0
"""The stage and validity of every package: ``keymint status``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime

from keymint.api import LoadedPolicy
from keymint.errors import KeymintError
from keymint.plan import build, create, install
from keymint.plan.authority_files import trusted_chains
from keymint.plan.enclaves import hidden, installed, installed_certificate, orphans
from keymint.session import Session
from keymint.workspace import packages


@dataclass(frozen=True, slots=True)
class PackageRow:
    """The status of one package.

    Attributes:
        package: its name.
        stage: the last stage that it went through: ``source``, ``built`` or ``installed``; ``orphaned`` for an
            enclave without a source package, ``ignored`` for one whose package a KEYMINT_IGNORE hides.
        stale: the first verb that would do something for it, or empty.
        certificate_expires: end of validity of the installed certificate, UTC.
        permissions_expire: end of validity of the grant, UTC.
        problem: one line when the package cannot be loaded.
    """

    package: str
    stage: str
    stale: str
    certificate_expires: datetime | None
    permissions_expire: datetime | None
    problem: str = ""


def package_rows(session: Session, policy: LoadedPolicy | None) -> tuple[PackageRow, ...]:
    """Return a row for every source package and every installed enclave, sorted by name.

    Args:
        session: the workspace and its profile.
        policy: its policy, or None if it cannot be loaded; then packages are not compared with it.
    """
    names = packages(session.tree, session.workspace.src)
    enclaves = set(installed(session))
    chains = trusted_chains(session)
    stale = _differing(session, policy, names)
    rows = [_row(session, stale, name, chains, installed=name in enclaves) for name in names]
    rows += [
        PackageRow(name, "orphaned", "install --prune", _certificate_end(session, name), None)
        for name in orphans(session)
    ]
    rows += [PackageRow(name, "ignored", "", _certificate_end(session, name), None) for name in hidden(session)]
    return tuple(sorted(rows, key=lambda row: row.package))


def _certificate_end(session: Session, name: str) -> datetime | None:
    certificate = installed_certificate(session, name)
    return certificate.not_valid_after_utc if certificate else None


def _row(
    session: Session,
    differing: Mapping[str, str],
    name: str,
    chains: Mapping[str, bytes],
    *,
    installed: bool,
) -> PackageRow:
    end = _certificate_end(session, name)
    stale, problem, permissions_end = "", "", None
    try:
        built = build.is_built(session, name)
        session.package_files(name)
    except KeymintError as error:  # a file that is no file, or too large
        return PackageRow(name, "installed" if installed else "source", "", end, None, str(error.diagnostics[0]))
    stage = "installed" if installed else "built" if built else "source"
    try:
        package = session.package(name)
        permissions_end = package.grant.validity.not_after if package.grant.validity else None
        if name in differing:
            stale, problem = "create", differing[name]
    except KeymintError as error:
        stale, problem = "create", str(error.diagnostics[0])
    if not stale:
        if not built or not build.is_current(session, name):
            stale = "build"
        elif not installed or not install.is_current(session, name, chains):
            stale = "install"
    return PackageRow(name, stage, stale, end, permissions_end, problem)


def _differing(session: Session, policy: LoadedPolicy | None, names: Sequence[str]) -> Mapping[str, str]:
    """Return the packages that differ from the policy, each with a problem or an empty text."""
    if policy is None:
        return {}
    try:
        found = create.stale(session, policy, names)
    except KeymintError as error:
        return dict.fromkeys(names, str(error.diagnostics[0]))
    return {name: str(errors[0]) if errors else "" for name, errors in found.items()}
