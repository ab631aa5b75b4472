# SPDX-License-Identifier: Apache-2.0
"""Find names that differ by a typing mistake, by a walk through a trie instead of comparing all pairs."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from comarmor.patterns.steps import spend

_END = ""
"""The branch of a node that holds the name that ends there."""


class NameTrie:
    """Finds names by their edit distance.

    Args:
        names: names.
    """

    def __init__(self, names: Iterable[str]) -> None:
        self._root: dict[str, object] = {}
        for name in dict.fromkeys(names):
            node = self._root
            for char in name:
                node = node.setdefault(char, {})  # type: ignore[assignment]
            node[_END] = name

    def near(self, name: str, most: int) -> Iterator[str]:
        """Yield the names within a number of insertions, deletions and replacements of characters.

        V. I. Levenshtein, "Binary codes capable of correcting deletions, insertions, and reversals", 1966. Every branch
        of the trie that is visited counts as a step.
        """
        first = {length: length for length in range(min(most, len(name)) + 1)}
        todo: list[tuple[dict[str, object], dict[int, int]]] = [(self._root, first)]
        while todo:
            node, row = todo.pop()
            spend(2 + 2 * len(node))
            for char, below in node.items():
                if char == _END:
                    if row.get(len(name), most + 1) <= most:
                        yield str(below)
                    continue
                next_row = _next_row(name, row, char, most)
                if next_row and isinstance(below, dict):
                    todo.append((below, next_row))


def _next_row(name: str, row: dict[int, int], char: str, most: int) -> dict[int, int]:
    """Return the fewest edits for each length of a prefix of the name, after one more character of another name."""
    edits_by_length: dict[int, int] = {}
    for length in sorted({*row, *(each + 1 for each in row)}):
        if length > len(name):
            break
        edits = row.get(length, most) + 1
        if length:
            replaced = row.get(length - 1, most + 1) + (name[length - 1] != char)
            edits = min(edits, replaced, edits_by_length.get(length - 1, most) + 1)
        if edits <= most:
            edits_by_length[length] = edits
    last = max(edits_by_length, default=len(name))
    while last < len(name) and edits_by_length[last] < most:
        edits_by_length[last + 1] = edits_by_length[last] + 1
        last += 1
    return edits_by_length
