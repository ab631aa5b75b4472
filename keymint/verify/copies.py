# SPDX-License-Identifier: Apache-2.0
"""Copies of enclaves for transports, which read files and may take long.

A concurrent install neither waits for them nor changes the files that they read. Messages name the original
directories, not the copies.
"""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from comarmor.errors import Diagnostic
from keymint.api import Availability, Enclave, Tier, Transport, Verdict
from keymint.errors import KeymintError
from keymint.graph import Edge
from keymint.tree import Tree
from keymint.verify.usable_transports import names_rules


@dataclass(frozen=True, slots=True)
class Copies:
    """Copies of enclaves.

    Attributes:
        enclaves: the copies by subject.
        root: the directory of the copies.
        place: the directory of the originals.
    """

    enclaves: Mapping[str, Enclave]
    root: Path
    place: Path

    def read_by(self, transports: Mapping[str, Transport]) -> dict[str, Transport]:
        """Return transports that read the copies instead of the originals."""
        return {name: _OnCopies(each, self) for name, each in transports.items()}

    def back(self, text: str) -> str:
        """Replace the directory of the copies by the directory of the originals."""
        return text.replace(str(self.root), str(self.place))

    def named(self, error: KeymintError) -> KeymintError:
        """Return an error that names the originals."""
        return KeymintError.of(map(self._diagnostic, error.diagnostics), error.exit_code)

    def _diagnostic(self, diagnostic: Diagnostic) -> Diagnostic:
        where = diagnostic.where and replace(diagnostic.where, file=self.back(diagnostic.where.file))
        return replace(diagnostic, message=self.back(diagnostic.message), where=where, help=self.back(diagnostic.help))


@contextlib.contextmanager
def copied(
    tree: Tree, place: Path, enclaves: Mapping[str, Enclave], transports: Mapping[str, Transport]
) -> Iterator[Copies]:
    """Copy enclaves into a private temporary directory, which is removed at the end.

    Args:
        tree: the snapshot.
        place: the directory of the enclaves.
        enclaves: the enclaves by subject.
        transports: their readers; private keys are copied only if one of them needs more than documents.
    """
    keys = not all(names_rules(each.usable()) for each in transports.values())
    with tempfile.TemporaryDirectory(prefix="keymint-") as folder:
        root = Path(folder).resolve()
        own = {
            subject: replace(each, folder=root / each.folder.relative_to(place)) for subject, each in enclaves.items()
        }
        for subject, copy in own.items():
            _copy(tree, enclaves[subject].folder, copy.folder, keys=keys)
        copies = Copies(own, root, place)
        try:
            yield copies
        except KeymintError as error:
            raise copies.named(error) from error


def _copy(tree: Tree, source: Path, target: Path, *, keys: bool) -> None:
    target.mkdir(parents=True, exist_ok=True)
    for name, is_folder in tree.names(source):
        if is_folder or (name.endswith("key.pem") and not keys):
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


class _OnCopies:
    """Implements :class:`keymint.api.Transport`: a transport that reads copies."""

    def __init__(self, transport: Transport, copies: Copies) -> None:
        self._transport = transport
        self._copies = copies

    def usable(self) -> Availability:
        """See :meth:`keymint.api.Transport.usable`."""
        return self._transport.usable()

    def label(self, enclaves: Sequence[Enclave], edges: Iterable[Edge], tier: Tier) -> Iterator[tuple[Edge, Verdict]]:
        """See :meth:`keymint.api.Transport.label`."""
        own = [self._copies.enclaves[each.subject] for each in enclaves]
        try:
            for edge, verdict in self._transport.label(own, edges, tier):
                yield edge, replace(verdict, reason=self._copies.back(verdict.reason))
        except KeymintError as error:
            raise self._copies.named(error) from error
