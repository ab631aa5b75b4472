# SPDX-License-Identifier: Apache-2.0
"""Replace names by fewer patterns that match exactly these names.

Names that differ in one position share a pattern with a set of characters there: ``axle1 axle2 axle3`` become
``axle[123]``. The rest of the pattern is the same, so that it matches these names and no others.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from string import ascii_letters, digits

MEMBERS = frozenset(ascii_letters + digits + "_")
"""Characters that are allowed in a set: none of them is special there."""
RANGE_MARK = "-"
"""No set is put before it: some readers take it for a range."""

Pattern = tuple[str, ...]
"""For each position one character, or the sorted members of a set."""


def gather(names: Iterable[str]) -> tuple[Pattern, ...]:
    """Return few patterns, not always the fewest, that match exactly some names.

    Args:
        names: names; special characters stand for themselves.
    """
    by_length: dict[int, set[Pattern]] = {}
    for name in names:
        by_length.setdefault(len(name), set()).add(tuple(name))
    patterns: list[Pattern] = []
    for length, words in sorted(by_length.items()):
        positions = [index for index in range(length) if len({word[index] for word in words}) > 1]
        # The order matters: numbers fold best from the right, namespaces from the left.
        left, right = _fold(words, positions), _fold(words, positions[::-1])
        patterns += left if len(left) < len(right) else right
    return tuple(sorted(patterns))


def _fold(words: Iterable[Pattern], positions: Sequence[int]) -> list[Pattern]:
    """Fold at each position until nothing changes."""
    patterns = set(words)
    count = 0
    while len(patterns) != count:
        count = len(patterns)
        for index in positions:
            patterns = _fold_at(patterns, index)
    return sorted(patterns)


def _fold_at(words: Iterable[Pattern], index: int) -> set[Pattern]:
    """Replace patterns that differ only in one position by one pattern."""
    groups: dict[tuple[Pattern, Pattern], list[str]] = {}
    for word in words:
        groups.setdefault((word[:index], word[index + 1 :]), []).append(word[index])
    patterns: set[Pattern] = set()
    for (head, tail), members in groups.items():
        foldable = [each for each in members if MEMBERS.issuperset(each)] if tail[:1] != (RANGE_MARK,) else []
        choices = [each for each in members if each not in foldable]
        if foldable:
            choices.append("".join(sorted(set("".join(foldable)))))
        patterns.update((*head, each, *tail) for each in choices)
    return patterns
