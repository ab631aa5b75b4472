# SPDX-License-Identifier: Apache-2.0
"""Check the installed documents over all packages of a build type."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from datetime import timedelta

from comarmor.errors import Diagnostic
from keymint.api import BuildOptions, SharedInspection
from keymint.check.file_status import as_installed
from keymint.errors import KeymintError
from keymint.plan.authority_files import trusted_chains
from keymint.plan.build_types import shared_builder
from keymint.plan.enclaves import INSTALLED
from keymint.plan.shared_documents import build_shared, load_packages, record_key, users
from keymint.plan.shared_install import installed_shared, shared_roles
from keymint.plan.shared_proof import enclaves_of
from keymint.session import Session
from keymint.state import Stamp


def check_shared(session: Session, within: timedelta) -> tuple[Iterable[Diagnostic], set[str]]:
    """Return the findings on the installed shared documents, and the paths of these relative to the install space.

    Args:
        session: the workspace and its profile.
        within: report what expires within this time.
    """
    diagnostics: list[Diagnostic] = []
    files: set[str] = set()
    try:
        of_types = users(session)
    except KeymintError as error:
        return error.diagnostics, files
    for name in of_types:
        stamp = session.state.stamp(INSTALLED, record_key(name))
        try:
            inspection = _inspection(session, name, within)
        except KeymintError as error:
            diagnostics += error.diagnostics
            files |= set(stamp.outputs if stamp else ())
            continue
        files |= inspection.files.keys()
        builder = shared_builder(session, name)
        found = builder.check_shared(inspection) if builder else ()
        diagnostics += (*_on_disk(session, name, inspection, stamp), *found)
    return dict.fromkeys(diagnostics), files


def _inspection(session: Session, name: str, within: timedelta) -> SharedInspection:
    packages = load_packages(session, name)
    # What the options of a build accept was reported and accepted when the documents were built.
    built = build_shared(session, name, packages, BuildOptions(allow_vendor_specific=True))
    stamp, chains = session.state.stamp(INSTALLED, record_key(name)), trusted_chains(session)
    roles = shared_roles(packages, session.plugins.build_type(name))
    return SharedInspection(
        packages=packages,
        documents=built.documents,
        files=installed_shared(session, sorted({*built.documents, *(stamp.outputs if stamp else ())})),
        enclaves=enclaves_of(session, name),
        folder=session.workspace.shown(session.workspace.install),
        layout=session.profile.layout,
        chains={
            role: b"".join(dict.fromkeys(chains.get(each.name, b"") for each in of_role))
            for role, of_role in roles.items()
        },
        now=session.now,
        within_days=within / timedelta(days=1),
    )


def _on_disk(session: Session, name: str, inspection: SharedInspection, stamp: Stamp | None) -> Iterator[Diagnostic]:
    """Check that the files are there, their modes, and their recorded digests."""
    recorded: Mapping[str, str] = stamp.outputs if stamp else {}
    for path in sorted({*inspection.documents, *recorded, *inspection.files}):
        secret = stamp is not None and path in stamp.secret
        value, help_ = recorded.get(path, ""), "'keymint build' and 'keymint install' write it"
        yield from as_installed(session, session.workspace.install / path, value, help_, secret=secret)
    if stamp is None and inspection.files:
        message = f"there is no record of the installed shared documents of {name}"
        yield Diagnostic.note("record-missing", message, None, "'keymint install' makes one")
