# SPDX-License-Identifier: Apache-2.0
"""Copies of installed files for transports, which read them and may take long.

A concurrent install neither waits for them nor changes the files that they read. The copies have the same places in
their install space as the originals. Results and errors name the original directories, not the copies.
"""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Collection, Iterable, Iterator, Mapping
from pathlib import Path

from comarmor.values import Data, replace
from keymint.api import InstalledEnclave, Transport, Verdict
from keymint.errors import Diagnostic, KeymintError
from keymint.view.tree import Tree

_KEY = "key.pem"
"""How the names of private keys end, whatever is in them."""


class Copies(Data):
    """Copies of enclaves.

    Attributes:
        enclaves: the copies by subject.
        root: the install space of the copies.
        install: the install space of the originals.
    """

    enclaves: Mapping[str, InstalledEnclave]
    root: Path
    install: Path

    def back(self, text: str) -> str:
        """Replace the directory of the copies by the directory of the originals."""
        return text.replace(str(self.root), str(self.install))

    def original(self, verdict: Verdict) -> Verdict:
        """Return a verdict that names the originals."""
        where = verdict.where and verdict.where.with_files(self.back)
        return replace(verdict, reason=self.back(verdict.reason), where=where)

    @contextlib.contextmanager
    def named(self) -> Iterator[None]:
        """Let the errors of a block name the originals."""
        try:
            yield
        except KeymintError as error:
            raise KeymintError.of(map(self._diagnostic, error.diagnostics), error.exit_code) from error

    def _diagnostic(self, diagnostic: Diagnostic) -> Diagnostic:
        where = diagnostic.where and diagnostic.where.with_files(self.back)
        return replace(diagnostic, message=self.back(diagnostic.message), where=where, help=self.back(diagnostic.help))


@contextlib.contextmanager
def enclave_copies(
    tree: Tree,
    install: Path,
    enclaves: Mapping[str, InstalledEnclave],
    transports: Iterable[Transport],
    others: Collection[Path] = (),
    infrastructure: Collection[Path] = (),
) -> Iterator[Copies]:
    """Copy enclaves and shared files into a private temporary directory, which is removed at the end.

    Args:
        tree: the snapshot.
        install: the install space.
        enclaves: the enclaves by subject.
        transports: their readers; private keys are copied only if one of them needs more than documents.
        others: the folders of all further enclaves, whose files are not shared.
        infrastructure: those of them that belong to the infrastructure of a transport; they are copied too.
    """
    keys = not all(each.usable().names_rules for each in transports)
    with tempfile.TemporaryDirectory(prefix="keymint-") as folder:
        root = Path(folder).resolve()
        folders = {each.folder for each in enclaves.values()}
        shared = _shared(tree, install, folders.union(others))
        for source in sorted({*folders, *infrastructure, *shared}):
            _copy(tree, source, root / source.relative_to(install), keys=keys)
        copies = Copies(_moved(enclaves, install, root), root, install)
        with copies.named():
            yield copies


def _moved(enclaves: Mapping[str, InstalledEnclave], install: Path, root: Path) -> dict[str, InstalledEnclave]:
    """Return the enclaves of an install space at the same places of another one."""
    return {
        subject: replace(each, folder=root / each.folder.relative_to(install), install=root)
        for subject, each in enclaves.items()
    }


def _shared(tree: Tree, folder: Path, enclaves: Collection[Path]) -> Iterator[Path]:
    """Yield a folder and those below it that are in no enclave; hidden ones are ignored."""
    if folder in enclaves:
        return
    yield folder
    for name, is_folder in tree.names(folder):
        if is_folder and not name.startswith("."):
            yield from _shared(tree, folder / name, enclaves)


def _copy(tree: Tree, source: Path, target: Path, *, keys: bool) -> None:
    target.mkdir(parents=True, exist_ok=True)
    for name, is_folder in tree.names(source):
        if is_folder or (name.endswith(_KEY) and not keys):
            continue
        content = _content(tree, source / name)
        if content is not None:
            file = target / name
            file.touch(0o600)
            file.write_bytes(content)


def _content(tree: Tree, path: Path) -> bytes | None:
    """Return the content of a file. Links are followed, as vendors do; ``check`` reports them."""
    try:
        return tree.read(path)
    except KeymintError as error:
        if error.diagnostics[0].code != "symlink-refused":
            return None
    try:
        return path.read_bytes()
    except OSError:
        return None
