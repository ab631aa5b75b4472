# SPDX-License-Identifier: Apache-2.0
"""Documents in the build space, those of a package and shared ones: are they as they were built, or edited by hand?"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

from comarmor.errors import Diagnostic
from keymint.errors import KeymintError
from keymint.names import subject_of
from keymint.store.changes import Action, Step
from keymint.view.stamps import Stamp
from keymint.workspace.package_build_types import BUILD
from keymint.workspace.session import Inputs

OUTDATED, HAND_EDITED = "build-outdated", "hand-edited"
"""Codes of the diagnostics on stale builds and on documents that a person edited."""


def kept_documents_step(inputs: Inputs, stamp: Stamp, folder: Path, name: str, detail: str = "") -> Step | None:
    """Return the step for documents that need no build, edited or not; None if one is missing.

    Args:
        inputs: the workspace.
        stamp: the record of the documents.
        folder: their folder.
        name: the package; empty for shared documents.
        detail: a few words for the user if none was edited.
    """
    digests = {file: inputs.tree.digest(f"{folder}/{file}") for file in stamp.outputs}
    if None in digests.values():
        return None
    if edited := [file for file, value in digests.items() if value != stamp.outputs[file]]:
        return Step(BUILD, name, Action.KEPT, detail=f"{', '.join(edited)} edited by hand; -f rebuilds")
    return Step(BUILD, name, Action.UNCHANGED, detail=detail)


def refuse_edits(inputs: Inputs, key: str, folder: Path, existing: Mapping[str, bytes | None], name: str = "") -> None:
    """Refuse to replace a document that is not the recorded build.

    Args:
        inputs: the workspace.
        key: the key of the record of the documents.
        folder: their folder.
        existing: the present content of those that would change; None for one that does not exist.
        name: the package; empty for shared documents.

    Raises:
        KeymintError: a person edited one, or it is from elsewhere.
    """
    for file, content in existing.items():
        if content is None or inputs.state.wrote(BUILD, key, file, content):
            continue
        where = inputs.workspace.origin(folder / file)
        if name and inputs.state.stamp(BUILD, key) is None:
            raise KeymintError(
                "is not from a build of this workspace, and differs from what its sources give",
                where=where,
                help=f"{_rebuild(name)} replaces it",
                code="build-foreign",
            )
        raise KeymintError(
            "was edited by hand, and its sources changed too",
            where=where,
            help=f"{_rebuild(name)} discards the edit",
            code=HAND_EDITED,
        )


def edits(
    inputs: Inputs, key: str, folder: Path, documents: Mapping[str, bytes], name: str = ""
) -> Iterator[Diagnostic]:
    """Yield a warning for each document that is signed although it differs from the built one.

    Args:
        inputs: the workspace.
        key: the key of the record of the documents.
        folder: their folder.
        documents: the documents that are signed.
        name: the package; empty for shared documents.
    """
    message, help_ = "was edited by hand; signing the edited document", f"{_rebuild(name)} discards the edit"
    for file, content in documents.items():
        if not inputs.state.wrote(BUILD, key, file, content):
            where, subject = inputs.workspace.origin(folder / file), subject_of(name) if name else ""
            yield Diagnostic.warning(HAND_EDITED, message, where, help_, subject)


def _rebuild(name: str) -> str:
    return f"'keymint build -f {name}'" if name else "'keymint build -f'"
