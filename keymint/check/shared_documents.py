# SPDX-License-Identifier: Apache-2.0
"""Check the installed documents over all packages of a build type."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from datetime import timedelta

from comarmor.errors import Defects, Diagnostic
from keymint.api import BuildOptions, SharedInspection
from keymint.changes import file_mode
from keymint.check.file_status import modes
from keymint.plan.build_types import shared_builder
from keymint.plan.enclaves import INSTALLED
from keymint.plan.shared_documents import Users, build_shared, load_packages, record_key, users
from keymint.plan.shared_install import installed_shared
from keymint.plan.shared_proof import enclaves_of
from keymint.plan.trust_anchors import shared_anchors
from keymint.session import Session
from keymint.state import Stamp, digest


def check_shared(session: Session, within: timedelta) -> tuple[Iterable[Diagnostic], set[str]]:
    """Return the findings on the installed shared documents, and the paths of these relative to the install space.

    Args:
        session: the workspace and its profile.
        within: report what expires within this time.
    """
    defects = Defects()
    files: set[str] = set()
    of_types: Users = {}
    with defects:
        of_types = users(session)
    for name in of_types:
        stamp = session.state.stamp(INSTALLED, record_key(name))
        files |= set(stamp.outputs if stamp else ())
        with defects:
            inspection, builder = _inspection(session, name, stamp, within), shared_builder(session, name)
            files |= inspection.files.keys()
            own = list(_on_disk(session, name, inspection, stamp))
            missing = {each.where for each in own if each.code == "file-missing"}
            found = builder.check_shared(inspection) if builder else ()
            defects.found += (
                *own,
                *(each for each in found if each.code != "file-missing" or each.where not in missing),
            )
    return dict.fromkeys(defects.found), files


def _inspection(session: Session, name: str, stamp: Stamp | None, within: timedelta) -> SharedInspection:
    packages = load_packages(session, name)
    # What the options of a build accept was reported and accepted when the documents were built.
    built = build_shared(session, name, packages, BuildOptions(allow_vendor_specific=True))
    anchors = shared_anchors(session, packages, session.plugins.build_type(name))
    return SharedInspection(
        packages=packages,
        documents=built.documents,
        files=installed_shared(session, sorted({*built.documents, *(stamp.outputs if stamp else ())})),
        enclaves=enclaves_of(session, name),
        folder=session.workspace.shown(session.workspace.install),
        layout=session.profile.layout,
        chains={role: anchor.chain for role, anchor in anchors.items()},
        now=session.now,
        within_days=within / timedelta(days=1),
    )


def _on_disk(session: Session, name: str, inspection: SharedInspection, stamp: Stamp | None) -> Iterator[Diagnostic]:
    """Check that the files are there, their modes, and their recorded digests."""
    install, files = session.workspace.install, inspection.files
    for path in sorted({*inspection.documents, *(stamp.outputs if stamp else ())} - files.keys()):
        where, help_ = session.workspace.origin(install / path), "'keymint build' and 'keymint install' write it"
        yield Diagnostic.error("file-missing", "is missing", where, help_)
    for path, content in files.items():
        yield from modes(session, install / path, file_mode(secret=stamp is not None and path in stamp.secret), "")
        if stamp is not None and stamp.outputs.get(path, digest(content)) != digest(content):
            where = session.workspace.origin(install / path)
            message, help_ = "was changed after it was installed", "'keymint install' restores it"
            yield Diagnostic.error("file-changed", message, where, help_)
    if stamp is None and files:
        message = f"there is no record of the installed shared documents of {name}"
        yield Diagnostic.note("record-missing", message, None, "'keymint install' makes one")
