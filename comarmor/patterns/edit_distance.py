"""Names that differ by a slip of the pen: found by a walk through a tree of names, not by comparing all pairs."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from comarmor.patterns.steps import spend

_END = ""
"""The branch at which the names hang that end there."""


class NameTrie:
    """Names, found by how few characters differ.

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
        """Yield the names that so many insertions, deletions and replacements of a character turn into another one.

        V. I. Levenshtein, "Binary codes capable of correcting deletions, insertions, and reversals", 1966. Steps are
        counted for each branch of the tree that is looked at.
        """
        first = {at: at for at in range(min(most, len(name)) + 1)}
        todo: list[tuple[dict[str, object], dict[int, int]]] = [(self._root, first)]
        while todo:
            node, row = todo.pop()
            spend(2 + 2 * len(node))
            for char, below in node.items():
                if char == _END:
                    if row.get(len(name), most + 1) <= most:
                        yield str(below)
                    continue
                after = _after(name, row, char, most)
                if after and isinstance(below, dict):
                    todo.append((below, after))


def _after(name: str, row: dict[int, int], char: str, most: int) -> dict[int, int]:
    """Return the fewest edits for each prefix of a name, by its length, once a character more was read."""
    found: dict[int, int] = {}
    for at in sorted({*row, *(each + 1 for each in row)}):
        if at > len(name):
            break
        edits = row.get(at, most) + 1
        if at:
            edits = min(edits, row.get(at - 1, most + 1) + (name[at - 1] != char), found.get(at - 1, most) + 1)
        if edits <= most:
            found[at] = edits
    last = max(found, default=len(name))
    while last < len(name) and found[last] < most:
        found[last + 1] = found[last] + 1
        last += 1
    return found
