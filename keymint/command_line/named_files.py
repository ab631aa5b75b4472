# SPDX-License-Identifier: Apache-2.0
"""Files that the command line names: read with limits, and replaced as a whole."""

from __future__ import annotations

import hashlib
import os
import re
import stat
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from comarmor.values import replace
from keymint import SPACES, __version__
from keymint.api import LoadedPolicy
from keymint.errors import ExitCode, KeymintError, Origin
from keymint.output.report import Report
from keymint.run.run import Run
from keymint.store.changes import File
from keymint.store.user_files import write_files
from keymint.view.tree import read_file
from keymint.workspace.session import Session
from keymint.workspace.shipped_profiles import package_digest
from keymint.workspace.workspace import PROFILE_MARKER

if TYPE_CHECKING:
    from keymint.drawing.labelled_graph import LabelledGraph

# How outputs begin, each with its kind; policies are of none, since they are kept without --force.
_KIND = re.compile(
    rb'\{\s*"\$schema": "[^"]*/(sarif)/|\{\s*"format": "(keymint-\w+)"|(digraph keymint) '
    rb'|<\?xml[^>]*\?>\s*(?:<(testsuites) name="keymint |<(svg) [^>]*class="keymint")'
    rb'|<!DOCTYPE html>[^\']{,99}content="(default-src &#39;none&#39;; style-src)'
    rb"|-----BEGIN ([A-Z0-9 ]+)-----|.{257}(ustar)",
    re.DOTALL,
)


def read_input(run: Run, path: Path, most: int | None = None) -> bytes:
    """Return the content of a file that the user named; links are followed.

    Args:
        run: the run.
        path: the file.
        most: its largest size in bytes; :data:`keymint.view.tree.MAX_FILE` by default.

    Raises:
        KeymintError: it is missing, is not a regular file, or cannot be read.
    """
    resolved = user_path(run, path)
    try:
        content = read_file(resolved, most)
    except KeymintError as error:
        message = error.diagnostics[0].message
        raise KeymintError(message, where=Origin(str(path)), code=error.diagnostics[0].code) from error
    if content is None:
        raise KeymintError("no such file", where=Origin(str(path)), help="check the path", code="file-missing")
    return content


def write_outputs(
    run: Run,
    path: Path,
    content: bytes,
    beside: Mapping[str, bytes] | None = None,
    *,
    secret: bool = False,
    keep: KeymintError | None = None,
) -> list[str]:
    """Write a file that the user named, and files beside it, atomically; unchanged files are not written.

    Args:
        run: the run; with ``--dry-run`` nothing is written.
        path: the file.
        content: its bytes.
        beside: further files by path relative to its folder, written first.
        secret: the file is 0600 from its first byte, and the folder stays as it is.
        keep: the error if the file has other content; None replaces it.

    Returns:
        The files that are, or would be, written, as the user would type them.

    Raises:
        KeymintError: the path is a link or a directory, or the file is to be kept, or the system refuses; or, with code
            ``output-foreign``, a file is of another kind than what would replace it, or in a space of a workspace.
    """
    if keep and user_path(run, path).exists() and read_input(run, path) != content:
        raise keep
    folder = user_path(run, path.parent)
    wanted = {folder / name: File(data, secret=secret) for name, data in (beside or {}).items()}
    wanted[folder / path.name] = File(content, secret=secret)
    current = {place: _current(place) for place in wanted}
    changed = {place: file for place, file in wanted.items() if current[place] != file.content}
    for place, file in changed.items():
        _require_own(run, place, current[place], file.content)
    if not run.dry_run:
        write_files(folder, changed, run.console.waiting, wanted)
    return [str(path.parent / place.relative_to(folder)) for place in changed]


def write_errors(run: Run, path: Path, kind: str, report: Report) -> Report:
    """Write the errors of a verb as SARIF or JUnit XML; return its report, with another error if that fails."""
    from keymint.output.junit import JUnitCase, junit  # noqa: PLC0415 - few runs fail
    from keymint.output.sarif import of_diagnostics, sarif  # noqa: PLC0415

    tool, found = f"keymint {report.verb}", run.presented(report).diagnostics
    cases = [JUnitCase(run.place(each.where) or tool, each.code, (each.code, str(each)), str(each)) for each in found]
    try:
        is_sarif = kind == "sarif"
        written = sarif(tool, of_diagnostics(found), run.typed) if is_sarif else junit(tool, {tool: cases})
        write_outputs(run, path, written)
    except KeymintError as error:
        # The error may be that this very file is not to be replaced.
        return replace(report, diagnostics=tuple(dict.fromkeys((*report.diagnostics, *error.diagnostics))))
    return report


def replace_inputs(run: Run, changed: Mapping[Path, tuple[bytes, bytes]]) -> None:
    """Replace files that were read with :func:`read_input`; each keeps its mode, and is replaced in one step.

    Nothing is replaced before all of it is written beside. With ``--dry-run`` nothing is written.

    Args:
        run: the run.
        changed: content that was read, and new content, by path.

    Raises:
        KeymintError: a file changed meanwhile, or the system refuses.
    """
    if run.dry_run or not changed:
        return
    files: dict[Path, File] = {}
    for path, (before, content) in changed.items():
        if read_input(run, path) != before:
            help_ = "nothing was written; run the command again"
            raise KeymintError("changed meanwhile", where=Origin(str(path)), help=help_, code="file-changed")
        target = user_path(run, path)
        files[target] = File(content, mode=stat.S_IMODE(target.stat().st_mode))
    write_files(Path(os.path.commonpath([path.parent for path in files])), files, run.console.waiting)


def told_written(run: Run, path: Path, written: list[str]) -> list[str]:
    """Return lines that say which files :func:`write_outputs` wrote, or that the file at the path is up to date."""
    would = "would be written" if run.dry_run else "written"
    return [f"{file} {would}" for file in written] or [f"{path} is up to date"]


def deliver(run: Run, output: Path | None, content: bytes, keep: KeymintError | None = None) -> dict[str, Any]:
    """Write a document to the file that the user named, or print it.

    Args:
        run: the run.
        output: the file; None for standard output.
        content: the document.
        keep: as for :func:`write_outputs`.

    Returns:
        What the result of a verb says about it: the file, and what was written.

    Raises:
        KeymintError: the file cannot be written, or is to be kept.
    """
    if output is None:
        run.console.document(content)
        return {"file": None, "written": []}
    written = write_outputs(run, output, content, keep=keep)
    run.console.lines(told_written(run, output, written))
    return {"file": str(output), "written": written}


def replacement_refusal(path: Path | None, made: str, other: str, code: str) -> KeymintError:
    """Return the error for a file that has other content than the policy to write, and is to be kept.

    Args:
        path: the file.
        made: how the policy was made, a participle.
        other: what else the user may do than to replace it.
        code: code of the error.
    """
    message, help_ = f"exists and differs from the {made} policy", f"{other}, or replace it with --force"
    return KeymintError(message, where=Origin(str(path)), help=help_, code=code)


def source_files(run: Run, labelled: LabelledGraph) -> Mapping[str, bytes]:
    """Return the content of the files that a graph refers to, by name."""
    places = {
        label.where
        for edge in labelled.edges
        for label in (edge.policy, *edge.transports)
        if label is not None and label.where
    }
    files = sorted({each.file for place in places for each in (place, *place.chain) if not each.source})
    return {file: read_input(run, Path(file)) for file in files if user_path(run, Path(file)).exists()}


def made_of(
    run: Run, policy: LoadedPolicy | None = None, session: Session | None = None, graph: bytes = b""
) -> tuple[str, ...]:
    """Return when and of what a picture or report is made, in lines: the same bytes on the same day, or at one clock.

    Args:
        run: the run.
        policy: the policy; its digest is that of the sorted digests of the files that it was read from.
        session: the workspace; the digest of its keystore is that of what ``sha256sum`` prints for all installed files
            but private keys, sorted by path.
        graph: content of the file with a graph; empty if there is none.
    """
    lines = [f"keymint {__version__}, {run.setting.now:%Y-%m-%d}"]
    if graph:
        lines.append(f"graph sha256 {hashlib.sha256(graph).hexdigest()}")
    if policy is not None:
        digests = sorted(f"{digest.hex()}\n" for path, digest in policy.seen.items() if path.is_file())
        lines.append(f"policy sha256 {hashlib.sha256(''.join(digests).encode()).hexdigest()}")
    if session is not None:
        folder, tree = session.workspace.install, session.tree
        paths = (path for path, is_folder in tree.walk(folder) if not is_folder and not path.endswith("key.pem"))
        contents = {path.removeprefix(f"{folder}/"): tree.try_read(path) for path in paths}
        files = {name: hashlib.sha256(content).hexdigest() for name, content in contents.items() if content is not None}
        if files:
            lines.append(f"keystore sha256 {package_digest(files)}")
    return tuple(lines)


def _require_own(run: Run, path: Path, current: bytes | None, content: bytes) -> None:
    """Require that a file may be replaced: it is missing or empty, or an earlier output outside a workspace's spaces.

    Raises:
        KeymintError: it may not.
    """
    kind = _kind(content)
    if not current or kind is None:
        return
    spaces = list(run.known_workspace.spaces()) if run.known_workspace else []
    roots = (folder for folder in path.parents if os.path.lexists(f"{folder}/profile/{PROFILE_MARKER}"))
    spaces += [root / name for root in roots for name in (*SPACES, "install.next", ".keymint")]
    if _kind(current) != kind or any(map(path.is_relative_to, spaces)):
        message = "is no earlier output of this kind outside the spaces of a workspace, so it is not replaced"
        where, help_ = Origin(run.typed(str(path))), "name another file, or remove this one first"
        raise KeymintError(message, where=where, help=help_, code="output-foreign", exit_code=ExitCode.USAGE)


def _kind(content: bytes) -> bytes | None:
    """Return what kind of output a file is by how it begins; None if it is none, or a policy."""
    found = _KIND.match(content)
    return found and found[found.lastindex or 0]


def _current(path: Path) -> bytes | None:
    try:
        return read_file(path)
    except KeymintError as error:
        if error.diagnostics[0].code != "file-size":
            return None  # the store reports why it cannot be replaced
    with path.open("rb") as opened:
        return opened.read(512)  # enough to tell its kind


def user_path(run: Run, path: Path) -> Path:
    """Return a path that the user named as an absolute one, which need not exist; links are followed.

    Raises:
        KeymintError: no path can be like this.
    """
    try:
        return (run.setting.cwd / path).resolve()
    except (OSError, RuntimeError, ValueError) as error:
        raise KeymintError("is not a usable path", where=Origin(str(path)), code="file-missing") from error
