# SPDX-License-Identifier: Apache-2.0
"""Replace names by fewer patterns that match exactly these names.

Names that differ in one position share a pattern with a set of characters there: ``axle1 axle2 axle3`` become
``axle[123]``. The rest of the pattern is the same, so that it matches these names and no others.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import combinations, groupby
from operator import ne
from string import ascii_letters, digits

MEMBERS = frozenset(ascii_letters + digits + "_")
"""Characters that are allowed in a set: none of them is special there."""
RANGE_MARK = "-"
"""No set is put before it: some readers take it for a range."""

FEW = 6
"""Names of a length up to which it is faster to compare each with each."""

Pattern = tuple[str, ...]
"""For each position one character, or the sorted members of a set."""


def gather(names: Iterable[str]) -> tuple[Pattern, ...]:
    """Return few patterns, not always the fewest, that match exactly some names.

    Args:
        names: names; special characters stand for themselves.
    """
    distinct = set(names)
    close = similar(distinct)
    patterns: list[Pattern] = [tuple(name) for name in distinct - close]
    for words in _by_length(close):
        positions = _differing(words)
        # The order matters: numbers fold best from the right, namespaces from the left.
        left, right = (_fold(map(tuple, words), order) for order in (positions, positions[::-1]))
        patterns += left if len(left) < len(right) else right
    return tuple(sorted(patterns))


def similar(names: Iterable[str]) -> frozenset[str]:
    """Return the names that differ from another one in one position only: no other name can share a pattern."""
    found: set[str] = set()
    for words in _by_length(names):
        if len(words) <= FEW:
            for word, other in combinations(words, 2):
                if sum(map(ne, word, other)) == 1:
                    found.update((word, other))
            continue
        for index in _differing(words):
            seen: dict[str, str] = {}
            for word in words:
                other = seen.setdefault(word[:index] + word[index + 1 :], word)
                if other is not word:
                    found.update((word, other))
    return frozenset(found)


def _by_length(names: Iterable[str]) -> Iterable[list[str]]:
    """Return the distinct names of each length."""
    return [list(words) for _, words in groupby(sorted(set(names), key=len), len)]


def _differing(words: Iterable[str]) -> list[int]:
    """Return the positions in which words of the same length differ."""
    return [index for index, chars in enumerate(zip(*words, strict=True)) if len(set(chars)) > 1]


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
