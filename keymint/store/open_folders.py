# SPDX-License-Identifier: Apache-2.0
"""The folders below the roots of a store, opened component by component without following a link."""

from __future__ import annotations

import contextlib
import functools
import itertools
import os
import stat
from collections.abc import Iterator, Mapping
from pathlib import Path

from keymint.store.file_writing import FOLDER, check_component, make_folder, open_at, reported
from keymint.view.file_reading import file_error


class Roots:
    """The folders that a store may write to.

    Args:
        roots: absolute folders, each with whether it is private: then every folder below it is 0700.
        records: the folder of records; below one of the roots.
    """

    def __init__(self, roots: Mapping[Path, bool], records: Path) -> None:
        # Longest first: a path belongs to the innermost root.
        self.private = {str(root): roots[root] for root in sorted(roots, key=lambda each: -len(each.parts))}
        self.kept = frozenset((*self.private, str(records)))
        """The folders that are kept even if they are empty, and never replaced: they may be mount points."""
        self.common: dict[str, str] = {}
        """New folders in which several processes stage, each with the name that it has until the commit."""
        self.created: set[str] = set()
        """The roots that were created and whose names are not synchronised yet."""
        self.certain: set[str] = set()
        """The folders below a root whose names are synchronised, with all on the way to them."""
        self._prefixes = {f"{root}/": root for root in self.private}
        self.of = functools.lru_cache(maxsize=64)(self._of)

    def _of(self, path: str) -> str:
        """Return the root that a path belongs to.

        Raises:
            KeymintError: there is none.
        """
        text = f"{path}/"
        for prefix, root in self._prefixes.items():
            if text.startswith(prefix) and "/../" not in text:
                return root
        raise file_error(path, "confined", "is outside the workspace")

    def upward(self, path: str) -> Iterator[str]:
        """Yield a folder, and those around it that may be staged: also its root, if that is in another one."""
        root = self.of(path)
        while path != root:
            yield path
            path = os.path.dirname(path)
        above = os.path.dirname(root)
        # A private root is never staged: runs of other workspaces lock the folder itself.
        if not self.private[root] and f"{above}/".startswith(tuple(self._prefixes)):
            yield root


class OpenFolders(contextlib.AbstractContextManager["OpenFolders"]):
    """Opens folders below roots; the last one and those on the way to it stay open.

    Args:
        roots: where it may open folders.
        create: create missing folders.
    """

    def __init__(self, roots: Roots, *, create: bool = True) -> None:
        self._roots = roots
        self._create = create
        self._way: list[tuple[str, int]] = []

    def __exit__(self, *_: object) -> None:
        self._leave(0)

    def _leave(self, depth: int) -> None:
        while len(self._way) > depth:
            os.close(self._way.pop()[1])

    def open(self, path: str, *, private: bool = False) -> int:
        """Return the descriptor of a folder, which is valid until the next call.

        Args:
            path: the folder.
            private: the folder must be 0700.

        Raises:
            KeymintError: the path is not below a root, a link is in the way, or the system refuses.
        """
        root = self._roots.of(path)
        if self._way and self._way[0][0] != root:
            self._leave(0)
        depth = len(self._way)
        while depth and not f"{path}/".startswith(f"{self._way[depth - 1][0]}/"):
            depth -= 1
        self._leave(depth)
        if not self._way:
            self._way.append((root, self._open_root(root)))
        reached, opened = self._way[-1]
        closed = self._roots.private[root]
        for part in path[len(reached) + 1 :].split("/") if len(path) > len(reached) else ():
            check_component(part, path)
            reached = f"{reached}/{part}"
            with reported(path):
                opened = self._enter(opened, part, 0o700 if closed or (private and reached == path) else 0o755)
            self._way.append((reached, opened))
        if private and path != root:
            with reported(path):
                close_to_others(opened)
        return opened

    def _open_root(self, root: str) -> int:
        with reported(root):
            if self._create and not os.path.lexists(root):
                Path(root).parent.mkdir(parents=True, exist_ok=True)
                with contextlib.suppress(FileExistsError):
                    make_folder(root, 0o700 if self._roots.private[root] else 0o755)
                    self._roots.created.add(root)
            return os.open(root, FOLDER)

    def _enter(self, folder: int, name: str, mode: int) -> int:
        try:
            return os.open(name, FOLDER, dir_fd=folder)
        except FileNotFoundError:
            if not self._create:
                raise
            with contextlib.suppress(FileExistsError):
                make_folder(name, mode, folder)
            return os.open(name, FOLDER, dir_fd=folder)

    def sync(self, path: str) -> None:
        """Synchronise a folder, and those on the way to it once, which may be new, as the root may be.

        Args:
            path: the folder.

        Raises:
            KeymintError: the system could not write everything.
        """
        self.open(path)
        root, certain = self._way[0][0], self._roots.certain
        above = os.path.dirname(root)
        if root in self._roots.created and os.access(above, os.R_OK):
            with reported(root), open_at(above) as opened:
                os.fsync(opened)
        for (reached, opened), (below, _) in itertools.pairwise((*self._way, (path, 0))):
            if reached == path or below not in certain:
                with reported(reached):
                    os.fsync(opened)
        self._roots.created.discard(root)
        certain.update(reached for reached, _ in self._way)


def close_to_others(opened: int) -> None:
    """Give an open folder the mode 0700 if others may enter it."""
    if stat.S_IMODE(os.fstat(opened).st_mode) & 0o077:
        os.fchmod(opened, 0o700)
