# SPDX-License-Identifier: Apache-2.0
"""Read a keystore that another tool made, by the build type that knows its files.

No link leads out of it, whatever its files say.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator, Sequence
from datetime import datetime
from pathlib import Path

from comarmor.values import replace
from comarmor.xml.sandboxed_paths import read_bounded
from keymint.api import FoundKeystore, KeystoreFile, KeystoreFiles, KeystoreReader
from keymint.api.plugin_loader import Plugins
from keymint.errors import Diagnostic, KeymintError, Origin
from keymint.view.tree import MAX_FILE, read_error

_ENCLAVES = "enclaves"
MOST_FILES = 100_000
"""Files of a keystore; one of ten thousand enclaves has seven for each."""
MOST_BYTES = 1 << 30
"""Bytes of all files together."""


def found_in(
    plugins: Plugins, folder: Path, typed: str, now: datetime
) -> tuple[str, KeystoreReader, KeystoreFiles, FoundKeystore]:
    """Return the name of the build type that reads a keystore, its reader, the files of the keystore, and what it has.

    Files that cannot be read are findings.

    Args:
        plugins: the plugins.
        folder: the folder of the keystore.
        typed: the same as the user typed it.
        now: the clock, UTC.

    Raises:
        KeymintError: there is no such folder, it has no enclave, or no plugin reads keystores.
    """
    files, problems = read_keystore(folder, typed, now)
    for name in plugins.names("keymint.build_types"):
        if reader := plugins.build_type(name).keystores:
            found = reader.found(files)
            return name, reader, files, replace(found, diagnostics=(*problems, *found.diagnostics))
    raise KeymintError(
        "no installed build type reads keystores", help="'keymint plugins' lists them", code="adopt-unsupported"
    )


def read_keystore(folder: Path, typed: str, now: datetime) -> tuple[KeystoreFiles, tuple[Diagnostic, ...]]:
    """Read all files of a keystore, and return them with an error for each that cannot be read.

    Args:
        folder: its folder; it may be a link itself.
        typed: the same as the user typed it.
        now: the clock, UTC.

    Raises:
        KeymintError: there is no such folder, it is a part of a keystore, or far larger than any.
    """
    root, problem = folder, ""
    try:
        root = folder.resolve(strict=True)
        problem = "" if root.is_dir() else "is not a folder"
    except (OSError, RuntimeError):
        problem = "no such folder"
    if problem:
        help_ = "name the folder of a keystore"
        raise KeymintError(problem, where=Origin(typed), help=help_, code="keystore-missing")
    for depth, outer in enumerate(root.parents if not (root / _ENCLAVES).is_dir() else (), 1):
        if root.is_relative_to(outer / _ENCLAVES) and (outer / "public").is_dir():
            keystore = os.path.normpath(f"{typed}/{'../' * depth}")
            message, help_ = "is a part of a keystore", f"did you mean {keystore}?"
            raise KeymintError(message, where=Origin(typed), help=help_, code="keystore-unknown")
    files: dict[str, KeystoreFile] = {}
    problems: list[Diagnostic] = []
    size = 0
    for path in _paths(root, problems, typed):
        try:
            file = _read(root, path)
        except (KeymintError, OSError) as error:
            problems += _problems(error, f"{typed}/{path}")
            continue
        files[path] = file
        size += len(file.content)
        if len(files) > MOST_FILES or size > MOST_BYTES:
            raise KeymintError(
                f"has more than {MOST_FILES} files or {MOST_BYTES >> 20} MiB, which no keystore has",
                where=Origin(typed), help="name the folder of the keystore itself", code="keystore-size",
            )  # fmt: skip
    problems.sort(key=lambda each: str(each.where))
    return KeystoreFiles(typed, dict(sorted(files.items())), now), tuple(problems)


def _problems(error: KeymintError | OSError, place: str) -> Sequence[Diagnostic]:
    return (read_error(place, error) if isinstance(error, OSError) else error.at(Origin(place))).diagnostics


def _paths(root: Path, problems: list[Diagnostic], typed: str) -> Iterator[str]:
    """Yield the paths of all files and links below a folder; folders behind links are not entered."""

    def note(error: OSError) -> None:
        problems.extend(_problems(error, f"{typed}/{os.path.relpath(error.filename, root)}"))

    for folder, folders, names in os.walk(root, onerror=note):
        links = [name for name in folders if Path(folder, name).is_symlink()]
        folders[:] = [name for name in folders if name != ".git"]
        yield from (os.path.relpath(f"{folder}/{name}", root) for name in (*names, *links))


def _read(root: Path, path: str) -> KeystoreFile:
    """Return a file.

    Raises:
        KeymintError: it is neither a file nor a link to one, leads out of the keystore, also by way of other links, or
            to nothing, or it is too large.
        OSError: it cannot be read.
    """
    status = (root / path).lstat()
    link, real = "", root / path
    if stat.S_ISLNK(status.st_mode):
        link, problem, help_ = str(real.readlink()), "", ""
        try:
            real = real.resolve(strict=True)
        except (OSError, RuntimeError):
            problem, help_ = f"{link!r}, which is not there", "restore that file, or remove the link"
        status = real.lstat()
        if not problem and (link.startswith("/") or not real.is_relative_to(root)):  # perhaps by way of other links
            problem = f"{link!r}, which is not followed: it leads out of the keystore, or does so elsewhere"
            help_ = "replace it by the file itself, or by a relative link within the keystore"
        elif not problem and stat.S_ISDIR(status.st_mode):
            problem, help_ = f"the folder {link!r}, which is not followed", "replace it by the folder"
        if problem:
            raise KeymintError(f"is a link to {problem}", help=help_, code="keystore-link")
    if not stat.S_ISREG(status.st_mode):
        raise KeymintError("is not a regular file", help="remove it", code="file-kind")
    content = read_bounded(root, real, MAX_FILE + 1)
    if len(content) > MAX_FILE:
        raise KeymintError(f"has more than {MAX_FILE} bytes", help="remove it", code="file-size")
    return KeystoreFile(content, stat.S_IMODE(status.st_mode), link)
