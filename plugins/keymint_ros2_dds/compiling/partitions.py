# SPDX-License-Identifier: Apache-2.0
"""Partitions: the lists of partitions in which each topic pattern is allowed.

A policy decides on each partition separately: an endpoint is allowed if each of its partitions is. A permissions
document has one list per rule, and on Fast DDS the first rule that names the topic decides alone. So every name
must meet the one rule that has the union of its lists: where two lists meet, the intersection of their patterns gets a
rule of its own, and rules with more partitions come first. Denials in some partitions only are subtracted here, with
all patterns closed under intersection and the more specific ones first. A deny rule cannot express them: Cyclone DDS
applies one without partitions to the default partition only, and Fast DDS ignores the partitions of a deny rule.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from functools import lru_cache

from comarmor.patterns import glob as globs
from comarmor.patterns.expression import exact
from comarmor.patterns.glob import EVERYTHING, Glob, literal, sort_key
from comarmor.patterns.relations import TooComplexError, covers, disjoint, exactly_covers, intersection, maximal
from keymint_ros2_dds.lowering.lowered_rules import DEFAULT, EVERY, Partitions
from keymint_ros2_dds.lowering.portable_expressions import Step, UnportableError

MAX_PATTERNS = 128
"""Patterns with wildcards that a decision list over several lists of partitions may have."""


def uniform(allow: Iterable[Step], deny: Iterable[Step]) -> Partitions | None:
    """Return the list of partitions that all allowed patterns share, or None if they differ or a deny splits it.

    If no pattern is allowed, the list is the default partition.
    """
    lists = {_reduced(partitions or DEFAULT) for _, partitions in allow} or {DEFAULT}
    if len(lists) > 1:
        return None
    shared = lists.pop()
    return None if any(partitions_left(shared, listed) not in {(), shared} for _, listed in deny) else shared


@lru_cache(maxsize=4096)
def _reduced(partitions: Collection[str]) -> Partitions:
    """Return partitions as they are written in a document, sorted; without those that another one covers.

    Partitions that pass :func:`unsafe` need no escapes.
    """
    names = sorted({exact(globs.parse(expression)) for expression in partitions})
    wild = [(name, globs.parse(name)) for name in names if "*" in name]
    return tuple(
        name for name in names if not any(other != name and covers(glob, globs.parse(name)) for other, glob in wild)
    )


@lru_cache(maxsize=4096)
def _within(inner: Partitions, outer: Partitions) -> bool:
    """Tell whether one list of partitions covers another one."""
    return all(name in outer or any(covers(globs.parse(o), globs.parse(name)) for o in outer) for name in inner)


def partitions_left(allowed: Partitions, denied: Partitions) -> Partitions:
    """Return the allowed partitions that remain after a deny of ``denied`` (empty: every partition).

    Raises:
        ValueError: the deny removes only a part of the names that an expression matches.
    """
    refused = [globs.parse(expression) for expression in denied] if denied else [EVERYTHING]
    left: list[str] = []
    for expression in allowed:
        glob = globs.parse(expression)
        if any(covers(other, glob) for other in refused):
            continue
        if not all(disjoint(other, glob) for other in refused):
            raise ValueError
        left.append(expression)
    return tuple(left)


def decision_list(allow: Sequence[Step], deny: Sequence[Step]) -> list[Step]:
    """Return a decision list for patterns with different lists of partitions.

    Denials in every partition come before all allowed wildcards.

    Raises:
        UnportableError: a deny removes names from ``*``, or the patterns overlap in too many ways.
    """
    allow = [(pattern, _reduced(listed or DEFAULT)) for pattern, listed in allow]
    patterns = dict.fromkeys(pattern for pattern, _ in (*allow, *deny))
    literals = sorted(pattern for pattern in patterns if literal(pattern) is not None)
    denials = maximal(pattern for pattern, listed in deny if not listed and literal(pattern) is None)
    narrowed = [pattern for pattern, listed in deny if listed and literal(pattern) is None]
    allowed, denied = _Side(allow), _Side(deny)
    steps: list[Step] = [
        *((pattern, _effective(pattern, allowed, denied)) for pattern in literals),
        *((pattern, ()) for pattern in denials),
    ]
    if narrowed:
        wild = dict.fromkeys((*(pattern for pattern, _ in allowed.wild), *narrowed))
        closed = _specific_first(_closure([*wild], denials))
        steps += ((pattern, _effective(pattern, allowed, denied)) for pattern in closed)
        steps = list(_closed(_needed(steps)))
    else:
        steps = list(_closed(_needed([*steps, *_widest_first(_united(allowed.wild, denials))]), literals_only=True))
    return _freed(steps)


def _freed(steps: Iterable[Step]) -> list[Step]:
    """Return steps with those first that overlap no denial and overtake no overlapping step with other partitions."""
    steps = list(steps)
    denies = [pattern for pattern, listed in steps if not listed]
    free: list[Step] = []
    later: list[Step] = []
    for pattern, listed in steps:
        overtaken = (other for other, partitions in later if partitions != listed)
        overlaps = any(not disjoint(pattern, other) for other in (*denies, *overtaken))
        (later if overlaps or not listed else free).append((pattern, listed))
    return [*free, *later]


def _united(wild: Iterable[Step], denials: Sequence[Glob]) -> dict[Glob, Partitions]:
    """Return patterns with lists so that, of the patterns that match a name, one has the partitions of all others.

    The intersection of two patterns needs a step of its own only if neither list covers the other one.
    """
    lists: dict[Glob, Partitions] = {}
    for pattern, listed in wild:
        if not any(covers(denial, pattern) for denial in denials):
            lists[pattern] = _reduced(frozenset((*lists.get(pattern, ()), *listed)))
    todo = list(lists)
    while todo:
        pattern = todo.pop()
        for other in list(lists):
            first, second = lists[pattern], lists[other]
            if _within(first, second) or _within(second, first):
                continue
            both = _reduced(frozenset((*first, *second)))
            for piece in _intersection(pattern, other):
                if any(covers(denial, piece) for denial in denials):
                    continue
                if any(_within(both, known) and covers(wider, piece) for wider, known in lists.items()):
                    continue
                lists[piece] = _reduced(frozenset((*lists.get(piece, ()), *both)))
                todo.append(piece)
                _check_count(lists, piece)
    return lists


def _widest_first(steps: Mapping[Glob, Partitions]) -> list[Step]:
    """Return steps in a fixed order in which none follows one with fewer partitions."""
    lists = sorted(set(steps.values()))
    weight = {listed: sum(_within(other, listed) for other in lists) for listed in lists}
    return sorted(steps.items(), key=lambda step: (-weight[step[1]], step[1], sort_key(step[0])))


def _intersection(pattern: Glob, other: Glob) -> tuple[Glob, ...]:
    """Return the pieces of an intersection.

    Raises:
        UnportableError: there are too many pieces.
    """
    try:
        return intersection(pattern, other)
    except TooComplexError:
        raise UnportableError(pattern, "it overlaps with others in too many ways") from None


def _check_count(patterns: Collection[Glob], pattern: Glob) -> None:
    if len(patterns) > MAX_PATTERNS:
        raise UnportableError(pattern, "patterns with different partitions overlap in too many ways")


def _closed(steps: Sequence[Step], *, literals_only: bool = False) -> Iterator[Step]:
    """Yield steps, each followed by a denial if a later step would allow its names in more partitions.

    With ``literals_only`` the wildcards are ordered so that each name meets all of its partitions first. A literal may
    have fewer partitions than the wildcards after it, because a denial of that name removed some.

    If the topic matches and the partition does not, the standard and Cyclone DDS continue with the next rule. On Fast
    DDS the first rule that names the topic decides alone, so the denial changes nothing there.
    """
    wild = [(index, step) for index, step in enumerate(steps) if literal(step[0]) is None]
    for index, (pattern, listed) in enumerate(steps):
        yield pattern, listed
        if literals_only and literal(pattern) is None:
            continue
        # Literals come first and once, so only wildcards can match the same names later.
        wider = (other for later, (other, partitions) in wild if later > index and not _within(partitions, listed))
        if listed and listed != EVERY and any(not disjoint(pattern, other) for other in wider):
            yield pattern, ()


def _needed(steps: Sequence[Step]) -> list[Step]:
    """Drop the steps without which every name meets the same list."""
    kept: list[Step] = []
    wild: list[Step] = []
    for step in reversed(steps):
        pattern, listed = step
        following = next((other for other in reversed(wild) if not disjoint(other[0], pattern)), (EVERYTHING, ()))
        if following[1] != listed or not covers(following[0], pattern):
            kept.append(step)
            if literal(pattern) is None:
                wild.append(step)
    return kept[::-1]


class _Side:
    """Patterns with their partitions; literals separately, since there may be many."""

    def __init__(self, items: Iterable[Step]) -> None:
        self.wild: list[Step] = []
        self._exact: dict[Glob, list[Partitions]] = {}
        for pattern, listed in items:
            if literal(pattern) is None:
                self.wild.append((pattern, listed))
            else:
                self._exact.setdefault(pattern, []).append(listed)

    def covering(self, pattern: Glob) -> Iterator[Step]:
        """Yield the items that cover a pattern; a literal covers only itself.

        Raises:
            TooComplexError: the search exceeded its limit.
        """
        for listed in self._exact.get(pattern, ()):
            yield pattern, listed
        for item in self.wild:
            if exactly_covers(item[0], pattern):
                yield item


def _effective(pattern: Glob, allow: _Side, deny: _Side) -> Partitions:
    try:
        listed = frozenset(name for _, names in allow.covering(pattern) for name in names)
        denied = list(deny.covering(pattern))
    except TooComplexError:
        raise UnportableError(pattern, "its overlaps with other patterns are too complex to compute") from None
    left = _reduced(listed)
    for other, names in denied:
        if left:
            try:
                left = partitions_left(left, names)
            except ValueError:
                reason = f"it removes a part of the partitions {' '.join(left)}, which vendors read differently"
                raise UnportableError(other, reason) from None
    return left


def _closure(wild: Sequence[Glob], denials: Sequence[Glob]) -> list[Glob]:
    """Return the patterns and all their intersections, except those that a denial covers."""
    closure = {pattern: None for pattern in wild if not any(covers(denial, pattern) for denial in denials)}
    todo = list(closure)
    while todo:
        pattern = todo.pop()
        for other in list(closure):
            for piece in _intersection(pattern, other):
                known = any(covers(each, piece) and covers(piece, each) for each in closure)
                if piece not in closure and not known and not any(covers(denial, piece) for denial in denials):
                    closure[piece] = None
                    todo.append(piece)
                _check_count(closure, piece)
    return list(closure)


def _specific_first(patterns: Iterable[Glob]) -> list[Glob]:
    """Return patterns in a fixed order in which none follows one that covers it."""
    remaining = sorted(patterns, key=sort_key)
    ordered: list[Glob] = []
    while remaining:
        ready = [p for p in remaining if not any(q is not p and covers(p, q) and not covers(q, p) for q in remaining)]
        ordered += ready
        remaining = [p for p in remaining if p not in ready]
    return ordered
