# SPDX-License-Identifier: Apache-2.0
"""The stage ``init``: the profile of a new workspace, and the policy that it names."""

from __future__ import annotations

import os
from pathlib import Path

from keymint.api import Bootstrap
from keymint.errors import ExitCode, KeymintError
from keymint.store.changes import Action, File, FolderChange, Plan, Step, by_folder, folder_changes
from keymint.workspace.session import Inputs, Session
from keymint.workspace.workspace import PROFILE_MARKER

STAGE = "init"
_IGNORED = b"# Secrets, and files that Keymint can build again.\n/private/\n/build/\n/install/\n/.keymint/\n"


def plan_init(inputs: Inputs, profile_type: str, request: Bootstrap) -> Plan:
    """Plan the files of a new workspace; existing files are kept.

    Raises:
        KeymintError: no such profile type, distro or layout.
    """
    root = inputs.workspace.profile
    files = inputs.plugins.profile_type(profile_type).bootstrap(request)
    missing = {path: File(content) for path, content in sorted(files.items()) if inputs.tree.read(root / path) is None}
    folders = by_folder(root, missing)
    # The marker makes the folder a workspace, so it is the last file to be written.
    changes = [FolderChange(folder, new) for folder, new in folders.items() if folder != root]
    ordered = dict(sorted(folders.get(root, {}).items(), key=lambda item: item[0] == PROFILE_MARKER))
    if inputs.tree.read(inputs.workspace.root / ".gitignore") is None:
        changes.append(FolderChange(inputs.workspace.root, {".gitignore": File(_IGNORED)}))
    changes.append(FolderChange(root, ordered))
    return Plan((Step(STAGE, "", Action.CREATED, tuple(changes), "workspace profile"),), inputs.state)


def refuse_unsupported(session: Session) -> None:
    """Refuse a new profile that a build type of its packages cannot serve.

    Raises:
        KeymintError: a build type has no such layout, or its transport does not exist for the distribution.
    """
    profile = session.profile
    for build_type in session.build_types.values():
        if profile.layout not in build_type.LAYOUTS:
            raise KeymintError(
                f"the transport {build_type.TRANSPORT} has no layout {profile.layout!r}",
                help=f"it has {', '.join(build_type.LAYOUTS)}; an older distribution may need another transport",
                code="layout-unsupported",
                exit_code=ExitCode.USAGE,
            )
    session.needed_infrastructure()


def plan_policy(session: Session, policy: str) -> Plan:
    """Plan to change the policy that a workspace's profile names, if it names another one.

    Args:
        session: the workspace and its profile.
        policy: path of the policy relative to the profile space.

    Raises:
        KeymintError: the profile's list of policies was edited by hand.
    """
    profile = session.profile
    wanted = (session.workspace.profile / policy).resolve()
    if [source.path.resolve() for source in profile.policies] == [wanted]:
        return Plan((), session.state)
    files = session.profile_type.with_policy(profile.files, policy)
    changes = folder_changes(session.tree, session.workspace.profile, files)
    return Plan((Step(STAGE, "", Action.UPDATED, changes, f"policy {policy}"),), session.state)


def policy_path(policy: Path, profile: Path) -> str:
    """Return a policy's path as a profile names it: relative, so that a checkout works anywhere."""
    return os.path.relpath(policy.resolve(), profile.resolve())
