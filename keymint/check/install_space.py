"""Check the files of the install space outside the enclaves."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from comarmor.errors import Diagnostic, Origin, Severity
from keymint.api import Artifact
from keymint.check.file_status import modes
from keymint.plan import gitignore
from keymint.plan.enclaves import enclave_files, installed
from keymint.session import Inputs, Session
from keymint.workspace import packages


def shared_files(session: Session) -> Iterator[Diagnostic]:
    """Yield the findings on the install space outside the enclaves."""
    workspace, layout = session.workspace, session.profile.layout
    enclaves = {workspace.enclaves(layout) / name for name in installed(session)}
    expected: dict[str, bytes] = {}
    known = set(packages(session.tree, workspace.src))
    names = {str(folder.relative_to(workspace.enclaves(layout))): folder for folder in enclaves}
    artifacts = {
        f"/{name}": {file: Artifact(content) for file, content in enclave_files(session, folder, "")[0].items()}
        for name, folder in names.items()
        if name in known or known.isdisjoint(names)  # if all are hidden or orphaned, they still need the shared files
    }
    for info in session.plugins.infos:
        if info.group == "keymint.build_types" and artifacts:
            shared_files = session.plugins.build_type(info.name).shared(artifacts, layout)
            expected |= {path: artifact.content for path, artifact in shared_files.items()}
    for path in _files_below(session, workspace.install):
        relative = str(path.relative_to(workspace.install))
        if path.parent in enclaves or path == workspace.install / gitignore.NAME:
            continue
        if relative not in expected:
            yield Diagnostic(
                "file-unexpected",
                Severity.WARNING,
                "is in the install space, but belongs to no enclave",
                Origin(workspace.shown(path)),
                "remove it",
            )
        else:
            yield from modes(session, path, 0o644, "")
            if session.tree.has_file(path) and session.tree.try_read(path) != expected[relative]:
                yield Diagnostic(
                    "file-changed",
                    Severity.ERROR,
                    "differs from the enclaves' content",
                    Origin(workspace.shown(path)),
                    "'keymint install' restores it",
                )
    for folder in _empty_folders(session, workspace.install):
        message = "is an empty folder in the install space that Keymint did not create"
        yield Diagnostic("folder-unexpected", Severity.WARNING, message, Origin(workspace.shown(folder)), "remove it")
    for relative in expected:
        if session.tree.status(workspace.install / relative) is None:
            yield Diagnostic(
                "file-missing",
                Severity.ERROR,
                "is missing",
                Origin(workspace.shown(workspace.install / relative)),
                "'keymint install' restores it",
            )


def _files_below(inputs: Inputs, folder: Path) -> Iterator[Path]:
    for name, is_folder in inputs.tree.names(folder):
        if is_folder:
            yield from _files_below(inputs, folder / name)
        else:
            yield folder / name


def _empty_folders(inputs: Inputs, folder: Path) -> Iterator[Path]:
    """Yield the empty folders below a folder."""
    for name, is_folder in inputs.tree.names(folder):
        if is_folder:
            if not inputs.tree.names(folder / name):
                yield folder / name
            yield from _empty_folders(inputs, folder / name)
