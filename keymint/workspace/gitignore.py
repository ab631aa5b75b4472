# SPDX-License-Identifier: Apache-2.0
"""The ``.gitignore`` files that keep git out of spaces with secrets or generated files.

Each such space has one at its top, wherever an option puts the space. No enclave contains one, so none is copied to a
robot.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from keymint.store.changes import File, FolderChange, Plan
from keymint.workspace.workspace import Workspace

NAME = ".gitignore"
_EVERYTHING = b"# Secrets, or files that Keymint can make again: none of them belongs into git.\n*\n"


def missing_files(workspace: Workspace, plan: Plan) -> Sequence[FolderChange]:
    """Return the missing ``.gitignore`` files of the spaces that a plan writes to, or that exist.

    An existing file belongs to the user and is kept. A space that is a link or read-only is skipped, unless the plan
    writes to it anyway.
    """
    written = {str(change.folder) for change in plan.changes() if change.written}
    if written:
        written.add(str(workspace.state))  # has the record of what is written
    spaces = (workspace.private, workspace.build, workspace.install, workspace.next_install, workspace.state)
    kept = [space for space in spaces if space != workspace.next_install and _can_be_written(space)]
    return [
        FolderChange(space, {NAME: File(_EVERYTHING)}, private=space == workspace.private)
        for space in spaces
        if not os.path.lexists(space / NAME)
        and (space in kept or any(f"{folder}/".startswith(f"{space}/") for folder in written))
    ]


def _can_be_written(space: Path) -> bool:
    return space.is_dir() and not space.is_symlink() and os.access(space, os.W_OK)
