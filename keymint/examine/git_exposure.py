# SPDX-License-Identifier: Apache-2.0
"""Find private keys that git tracks, or that ``git add`` would add."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from pathlib import Path

from comarmor.errors import Diagnostic
from keymint.errors import KeymintError
from keymint.host.git import GIT_MISSING, run_git
from keymint.pki import key_files
from keymint.workspace import gitignore
from keymint.workspace.session import Inputs

_MOST = 64 * 1024
"""Bytes up to which a file is searched for a private key."""
_LIST = ("-c", "core.fsmonitor=false", "-c", "core.hooksPath=/dev/null", "ls-files", "-z")
"""Lists files without starting programs that the repository's configuration names."""


def git_exposure(inputs: Inputs) -> Iterator[Diagnostic]:
    """Yield the findings on the private keys in all spaces; none without a repository or without git."""
    for space in inputs.workspace.spaces():
        if _in_repository(space.resolve()):
            yield from _of_space(inputs, space)


def _of_space(inputs: Inputs, space: Path) -> Iterator[Diagnostic]:
    files = (Path(path) for path, is_folder in inputs.tree.walk(space) if not is_folder)
    keys = [path for path in files if _is_secret(inputs, path)]
    if not keys:
        return
    environment = _plain(inputs.environment)
    try:
        tracked = _listed(space, "--cached", environment)
        added = _listed(space, "--others", environment)
    except KeymintError as error:
        defect = error.diagnostics[0]
        if defect.code != GIT_MISSING:
            message = f"whether git tracks private keys is unknown: {defect.message}"
            yield Diagnostic.note("git-unknown", message, inputs.workspace.origin(space))
        return
    guard = inputs.workspace.shown(space / gitignore.NAME)
    stop = f"write the line '*' into {guard}"
    replace = "replace it, since whoever has the repository has it"
    yield from _finding(inputs, keys, tracked, "key-tracked", "that git tracks", f"'git rm --cached' it, and {replace}")
    yield from _finding(inputs, keys, added - tracked, "key-exposed", "that 'git add' would take", stop)


def _finding(
    inputs: Inputs, keys: list[Path], listed: frozenset[Path], code: str, what: str, help_: str
) -> Iterator[Diagnostic]:
    """Yield one finding for all private keys of a space that are listed."""
    exposed = [path for path in keys if path in listed or any(folder in listed for folder in path.parents)]
    exposed = [path for path in exposed if not key_files.is_public(inputs.tree.try_read(path) or b"")]
    if exposed:
        more = f", like {len(exposed) - 1} more" if len(exposed) > 1 else ""
        message = f"is a private key {what}{more}"
        yield Diagnostic.error(code, message, inputs.workspace.origin(exposed[0]), help_)


def _in_repository(folder: Path) -> bool:
    return any(os.path.lexists(above / ".git") for above in (folder, *folder.parents))


def _listed(space: Path, which: str, environment: Mapping[str, str]) -> frozenset[Path]:
    """Return the files below a space that git lists; a repository inside of it is one entry."""
    names = run_git((*_LIST, which, "--exclude-standard", "--", "."), space, environment).split(b"\0")
    return frozenset(space / os.fsdecode(name.removesuffix(b"/")) for name in names if name)


def _plain(environment: Mapping[str, str]) -> Mapping[str, str]:
    """Return an environment in which git only reads the repository of a space."""
    kept = {name: value for name, value in environment.items() if not name.startswith("GIT_") or "CONFIG" in name}
    return {**kept, "LC_ALL": "C", "GIT_OPTIONAL_LOCKS": "0", "GIT_TERMINAL_PROMPT": "0"}


def _is_secret(inputs: Inputs, path: Path) -> bool:
    """Tell whether a file contains a private key; in the private space all files do."""
    if path.is_relative_to(inputs.workspace.private):
        return path.name != gitignore.NAME
    status = inputs.tree.status(path)
    try:
        return status is not None and status.st_size <= _MOST and key_files.has_any(inputs.tree.read(path) or b"")
    except KeymintError:
        return False
