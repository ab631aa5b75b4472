# SPDX-License-Identifier: Apache-2.0
"""Plan the files of the install space that all enclaves share."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from keymint.api import Artifact
from keymint.changes import Action, File, Step, changed
from keymint.plan.enclaves import INSTALLED, KEY, enclave_files, installed
from keymint.session import Session


def shared_steps(session: Session, changed_enclaves: Mapping[str, tuple[str, Mapping[str, Artifact]]]) -> list[Step]:
    """Return the steps that write the shared files.

    Args:
        session: the workspace and its profile.
        changed_enclaves: build type and files of each enclave that changes, by package.
    """
    if not changed_enclaves:
        return []
    by_type: dict[str, dict[str, Mapping[str, Artifact]]] = {}
    types = {build_type for build_type, _ in changed_enclaves.values()}
    for name in sorted({*changed_enclaves, *installed(session)}):
        if name in changed_enclaves:
            build_type, artifacts = changed_enclaves[name]
            by_type.setdefault(build_type, {})[f"/{name}"] = artifacts
        elif len(types) == 1:
            existing, _ = enclave_files(session, name)
            kept = {file: Artifact(content, secret=file == KEY) for file, content in existing.items()}
            by_type.setdefault(next(iter(types)), {})[f"/{name}"] = kept
    steps = []
    for name, enclaves in sorted(by_type.items()):
        plugin = session.plugins.build_type(name)
        folders: dict[Path, dict[str, File]] = {}
        for relative, artifact in plugin.shared(enclaves, session.profile.layout).items():
            path = session.workspace.install / relative
            folders.setdefault(path.parent, {})[path.name] = File(artifact.content, secret=artifact.secret)
        changes = [change for folder, files in folders.items() for change in changed(session.tree, folder, files)]
        if changes:
            existed = any(session.tree.read(folder / name) for folder, files in folders.items() for name in files)
            action = Action.UPDATED if existed else Action.CREATED
            steps.append(Step(INSTALLED, "", action, tuple(changes), "shared by all enclaves"))
    return steps
