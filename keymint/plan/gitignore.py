"""Which spaces git is kept out of: those with secrets, and those that Keymint can make again.

A ``.gitignore`` at the top of each such space goes with it wherever an option puts it. None lies inside an enclave, so
none is copied to a robot.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from keymint.changes import File, FolderChange, Plan
from keymint.workspace import Workspace

NAME = ".gitignore"
_EVERYTHING = b"# Secrets, or files that Keymint can make again: none of them belongs into git.\n*\n"


def missing(workspace: Workspace, plan: Plan) -> Sequence[FolderChange]:
    """Return the files that keep git out of the spaces that a plan writes to, or that are there.

    One that is there is the user's, whatever it says. A space that is a link or read-only is left as it is, unless the
    plan writes to it anyway.
    """
    written = {change.folder for step in plan.steps for change in step.changes if change.files}
    if written:
        written.add(workspace.state)  # has the record of what is written
    spaces = (workspace.private, workspace.build, workspace.install, workspace.state)
    return [
        FolderChange(space, {NAME: File(_EVERYTHING)}, private=space == workspace.private)
        for space in spaces
        if not os.path.lexists(space / NAME)
        and (any(folder.is_relative_to(space) for folder in written) or _can_be_written(space))
    ]


def _can_be_written(space: Path) -> bool:
    return space.is_dir() and not space.is_symlink() and os.access(space, os.W_OK)
