"""Gathering names under few patterns that match exactly these names, and none besides.

Names that differ in one place only share a pattern with a set of characters there: ``axle1 axle2 axle3`` are
``axle[123]``. Since the rest of the pattern is the same, it matches what the names together are, and nothing else.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from string import ascii_letters, digits

MEMBERS = frozenset(ascii_letters + digits + "_")
"""Characters that a set may hold: none of them has a meaning of its own there."""
BEFORE = "-"
"""No set is put before one of these, since some matchers take it for the middle of a range."""

Pattern = tuple[str, ...]
"""What stands at each place: one character, or the members of a set, sorted."""


def gather(names: Iterable[str]) -> tuple[Pattern, ...]:
    """Return patterns that match exactly some names; few, but not always the fewest.

    Args:
        names: names; a character that is special elsewhere stands for itself.
    """
    by_length: dict[int, set[Pattern]] = {}
    for name in names:
        by_length.setdefault(len(name), set()).add(tuple(name))
    found: list[Pattern] = []
    for length, words in sorted(by_length.items()):
        places = [at for at in range(length) if len({word[at] for word in words}) > 1]
        # Which place goes first decides what is left for the others: numbers fold from the right, namespaces from left.
        left, right = _folded(words, places), _folded(words, places[::-1])
        found += left if len(left) < len(right) else right
    return tuple(sorted(found))


def _folded(words: Iterable[Pattern], places: Sequence[int]) -> list[Pattern]:
    known = set(words)
    count = 0
    while len(known) != count:
        count = len(known)
        for at in places:
            known = _folded_at(known, at)
    return sorted(known)


def _folded_at(words: Iterable[Pattern], at: int) -> set[Pattern]:
    """Make one pattern of those that differ at one place only."""
    alike: dict[tuple[Pattern, Pattern], list[str]] = {}
    for word in words:
        alike.setdefault((word[:at], word[at + 1 :]), []).append(word[at])
    found: set[Pattern] = set()
    for (head, tail), members in alike.items():
        fit = [each for each in members if MEMBERS.issuperset(each)] if tail[:1] != (BEFORE,) else []
        rest = [each for each in members if each not in fit]
        if fit:
            rest.append("".join(sorted(set("".join(fit)))))
        found.update((*head, each, *tail) for each in rest)
    return found
