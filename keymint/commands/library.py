"""Which rules of a policy are those of the shipped library, which every node includes."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path

from comarmor.errors import Origin


def library_rules(cwd: Path, shipped: Path, copy: Path | None = None) -> Callable[[Origin], bool]:
    """Return a function that tells whether a rule at a place is one of the shipped library.

    Args:
        cwd: folder that relative places start from.
        shipped: folder of the library.
        copy: folder of a workspace that holds a copy of the library, maybe among other files. A file there counts
            as long as nobody changed it: what a person wrote must not hide behind what every node may do.
    """
    folders = tuple(folder.resolve() for folder in (shipped, copy) if folder is not None)

    @cache
    def is_shipped(file: str) -> bool:
        path = (cwd / file).resolve()
        return any(path.is_relative_to(folder) and same(path, path.relative_to(folder)) for folder in folders)

    def same(path: Path, relative: Path) -> bool:
        try:
            return path.read_bytes() == (shipped / relative).read_bytes()
        except OSError:
            return False

    return lambda where: is_shipped(where.file)
