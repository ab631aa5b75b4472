# SPDX-License-Identifier: Apache-2.0
"""Check the files of the install space outside the enclaves."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from datetime import timedelta

from comarmor.errors import Diagnostic
from keymint.api import Artifact, BuildOptions, SharedInspection
from keymint.errors import KeymintError
from keymint.examine.file_status import as_installed, unexpected_file, unrecorded_note
from keymint.life.workspace_register import withdrawn
from keymint.names import ROOT
from keymint.stages import environment_scripts
from keymint.stages.proof.trust_anchors import shared_anchors
from keymint.stages.shared_documents import build_shared, load_packages, record_key, users
from keymint.stages.shared_install import enclaves_of, installed_shared
from keymint.view.stamps import Stamp, digest
from keymint.workspace import gitignore
from keymint.workspace.enclave_changes import EnclaveChanges, build_types_in_use, copies_of, shared_copies
from keymint.workspace.installed_enclaves import INSTALLED, enclave_names, files_in
from keymint.workspace.package_build_types import shared_builder
from keymint.workspace.session import Session

_OTHER_COPY = "differs from the enclaves' content"
_OTHER_SCRIPT = "differs from what Keymint writes, and shells that source it may use another keystore"


def outside_enclaves(session: Session, within: timedelta) -> Iterator[Diagnostic]:
    """Yield the findings on the install space outside the enclaves.

    Args:
        session: the workspace and its profile.
        within: report what expires within this time.
    """
    found, known = _shared(session, within)
    yield from found
    workspace, names = session.workspace, enclave_names(session)
    enclaves = {session.enclave_folder(name) for name in names if name != ROOT}
    own = {f"{session.enclave_folder(ROOT)}/{file}" for file in files_in(session, ROOT)} if ROOT in names else ()
    entries = list(session.tree.walk(workspace.install, skipped=""))
    files = [path for path, is_folder in entries if not is_folder]
    outside = [path for path in files if path.rpartition("/")[0] not in enclaves]
    expected = _copies(session, names, outside)
    all_revoked = not names and withdrawn(session)
    own_scripts = environment_scripts.scripts(
        session, session.profile.build_types if all_revoked else build_types_in_use(session)
    )
    targets = set(map(session.tree.follows, files))
    folders = [path for path, is_folder in entries if is_folder]
    restores = "'keymint install' restores it"
    empty = [folder for folder in folders if not session.tree.names(folder)]  # an error if one cannot be read
    for relative, content in expected.items():
        if (path := f"{workspace.install}/{relative}") not in own and path not in targets:
            yield from as_installed(session, path, digest(content), restores, _OTHER_COPY)
    for path in outside:
        relative = path.removeprefix(f"{workspace.install}/")
        if path in own or path in targets or relative in known or relative in expected or relative == gitignore.NAME:
            continue
        if relative in own_scripts:  # a workspace that was not installed since they exist has none
            is_ours = environment_scripts.is_ours(session.tree.try_read(path) or b"")
            help_ = restores if is_ours else "rename it or remove it, and run 'keymint install'"
            yield from as_installed(session, path, digest(own_scripts[relative]), help_, _OTHER_SCRIPT)
        else:
            yield unexpected_file(session, path, "is in the install space, but belongs to no enclave")
    for folder in empty:
        message = "is an empty folder in the install space that Keymint did not create"
        yield Diagnostic.warning("folder-unexpected", message, workspace.origin(folder), "remove it")


def _copies(session: Session, names: Sequence[str], outside: Iterable[str]) -> Mapping[str, bytes]:
    """Return the copies of enclaves' files that all installed build types have outside of them, by path.

    If all that have them were revoked, the copies stay for those that get a new key, and are compared with each other.

    Args:
        session: the workspace and its profile.
        names: the installed enclaves.
        outside: paths of the files outside of them.
    """
    sources = frozenset(session.packages())
    gone = frozenset(names) - sources if sources.intersection(names) else frozenset[str]()  # all hidden: they need them
    found = shared_copies(session, EnclaveChanges(removed=gone))
    if not any(found) and withdrawn(session):
        left = {"": {path.rpartition("/")[2]: Artifact(session.tree.try_read(path) or b"") for path in outside}}
        build_types = map(session.plugins.build_type, session.plugins.names("keymint.build_types"))
        found = [copies_of(session, each, left) for each in build_types if session.profile.layout in each.LAYOUTS]
    return {path: artifact.content for copies in found for path, artifact in copies.items()}


# -- documents over all packages ------------------------------------------------------------------------------------


def _shared(session: Session, within: timedelta) -> tuple[Iterable[Diagnostic], set[str]]:
    """Return the findings on the installed documents over all packages of a build type, and the paths of these."""
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
    stamp = session.state.stamp(INSTALLED, record_key(name))
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
    recorded: Mapping[str, str] = stamp.outputs if stamp else {}
    for path in sorted({*inspection.documents, *recorded, *inspection.files}):
        secret = stamp is not None and path in stamp.secret
        value, help_ = recorded.get(path, ""), "'keymint build' and 'keymint install' write it"
        yield from as_installed(session, session.workspace.install / path, value, help_, secret=secret)
    if stamp is None and inspection.files:
        yield unrecorded_note(f"the installed shared documents of {name}")
