"""Recognise the shipped policy library, and unchanged copies of it."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path

from comarmor.errors import Origin


def library_files(cwd: Path, shipped: Path, copy: Path | None = None) -> Callable[[str], str | None]:
    """Return a function that gives the name by which policies include a file of the library, or None for other files.

    Args:
        cwd: folder that relative paths start from.
        shipped: folder of the library.
        copy: folder of a workspace with a copy of the library. A file in it counts only while it is unchanged: rules
            that a person wrote must not be hidden as rules that every node has.
    """
    folders = tuple(folder.resolve() for folder in (shipped, copy) if folder is not None)

    @cache
    def name(file: str) -> str | None:
        path = (cwd / file).resolve()
        relative = (path.relative_to(folder) for folder in folders if path.is_relative_to(folder))
        return next((str(each) for each in relative if is_unchanged(path, shipped / each)), None)

    def is_unchanged(path: Path, original: Path) -> bool:
        try:
            return path.read_bytes() == original.read_bytes()
        except OSError:
            return False

    return name


def library_rules(cwd: Path, shipped: Path, copy: Path | None = None) -> Callable[[Origin], bool]:
    """Return a function that tells whether a rule is one of the library; arguments as :func:`library_files`."""
    name = library_files(cwd, shipped, copy)
    return lambda where: name(where.file) is not None
