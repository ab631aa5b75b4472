# SPDX-License-Identifier: Apache-2.0
"""Differences of a text file in the unified format (POSIX.1-2024, diff -u), which ``patch`` and ``git apply`` read."""

from __future__ import annotations

import re
from difflib import unified_diff

_NO_NEWLINE = "\\ No newline at end of file\n"


def file_diff(name: str, before: bytes, after: bytes) -> bytes:
    """Return what changes in a file, with three lines of context; empty for equal contents.

    Args:
        name: its path, relative to the folder where the difference can be applied with ``-p1``.
        before: its content.
        after: its new content.
    """
    old, new = f"a/{name.lstrip('/')}", f"b/{name.lstrip('/')}"
    lines = unified_diff(_lines(before), _lines(after), old, new)
    return "".join(line if line.endswith("\n") else f"{line}\n{_NO_NEWLINE}" for line in lines).encode(
        errors="surrogateescape"
    )


def first_difference(before: bytes, after: bytes) -> int:
    """Return the number of the first line that differs, from 1; 0 for equal contents."""
    if before == after:
        return 0
    pairs = zip(_lines(before), _lines(after), strict=False)
    return next(
        (number for number, (old, new) in enumerate(pairs, 1) if old != new),
        min(before.count(b"\n"), after.count(b"\n")) + 1,
    )


def _lines(content: bytes) -> list[str]:
    """Return lines with their line feeds; other characters that Python takes for line ends are part of a line."""
    return re.findall(r"[^\n]*\n|[^\n]+", content.decode(errors="surrogateescape"))
