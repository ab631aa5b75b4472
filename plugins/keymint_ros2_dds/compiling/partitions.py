"""Partitions: which lists each pattern of topic names may be used in.

A policy speaks of each partition by itself: an endpoint is allowed when each of its partitions is. A permissions
document holds one list per rule, and on Fast DDS the first rule that names the topic decides alone. So every name
must meet the one rule that has the union of its lists: where two lists meet, the intersection of their patterns gets a
rule of its own, and rules with more partitions come first. What is denied in some partitions only is subtracted here,
with all patterns closed under intersection and the more specific first; a deny rule cannot do it (Cyclone DDS takes one
without partitions to be about the default partition, Fast DDS ignores those it has).
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Self

from comarmor.patterns import glob as globs
from comarmor.patterns.glob import EVERYTHING, Glob, literal
from comarmor.patterns.printing import exact
from comarmor.patterns.relations import (
    TooComplexError,
    covers,
    disjoint,
    intersection,
    maximal,
    sort_key,
    surely_covers,
)
from comarmor.patterns.tokens import STAR, Star
from comarmor.rules import Effect
from keymint_ros2_dds.lowering.lower import Partitions

DEFAULT: Partitions = ("",)
EVERY: Partitions = ("*",)
MAX_PATTERNS = 128
"""Patterns with wildcards that a decision list over several lists of partitions may have."""


class PartitionError(Exception):
    """The partitions of a pattern cannot be said alike for all vendors.

    Attributes:
        pattern: the pattern it is about.
        reason: one line.
    """

    def __init__(self, pattern: Glob, reason: str) -> None:
        self.pattern = pattern
        self.reason = reason
        super().__init__(reason)


@dataclass(frozen=True, slots=True)
class Entry:
    """One step of a decision list: a name that matches is allowed in these partitions, or denied in all."""

    effect: Effect
    globs: tuple[Glob, ...]
    partitions: Partitions


def uniform(allow: Iterable[tuple[Glob, Partitions]], deny: Iterable[tuple[Glob, Partitions]]) -> Partitions | None:
    """Return the one list that all allowed patterns share, or None when they differ or a deny splits it.

    An empty result of nothing allowed is the default partition.
    """
    lists = {_plain(partitions) for _, partitions in allow}
    if not lists:
        return DEFAULT
    if len(lists) > 1:
        return None
    shared = lists.pop()
    if any(_left(shared, listed) not in {(), shared} for _, listed in deny):
        return None
    return shared


def touches(shared: Partitions, denied: Partitions) -> bool:
    """Tell whether a deny of these partitions takes all of a list away."""
    return not _left(shared, denied)


def unsafe(allow: Iterable[tuple[Glob, Partitions]]) -> Iterator[tuple[Glob, str]]:
    """Yield the patterns whose partitions vendors would not read alike, each with the reason.

    An endpoint's own wildcard is compared as text: with ``?`` or a bracket expression an endpoint in ``p*`` would be in
    ``p?``, and so would hear more than that. Of one ``*`` the text that it stands for may hold any wildcard: what the
    endpoint hears is within the expression all the same.
    """
    for pattern, partitions in allow:
        for expression in partitions:
            glob = globs.parse(expression)
            text = literal(glob)
            if text is None and not (glob.count(STAR) == 1 and all(isinstance(each, str | Star) for each in glob)):
                reason = (
                    "is neither a name nor one with a single '*', and vendors compare an endpoint's own wildcard with "
                    "it as text"
                )
                yield pattern, f"the partition {expression!r} {reason}"
            elif any(_misread(part) for part in glob if isinstance(part, str)):
                yield pattern, f"the partition {expression!r} has characters that vendors read differently"


def _misread(text: str) -> bool:
    return any(char in "*?[]\\" or not " " <= char <= "~" for char in text) or text != text.strip()


def _plain(partitions: Partitions) -> Partitions:
    """Return partitions as they are written in a document, sorted; ``*`` alone when it is among them.

    Those that have passed :func:`unsafe` are written as they are, since they have nothing to escape.
    """
    return _reduced(partitions) if partitions else DEFAULT


@lru_cache(maxsize=4096)
def _reduced(partitions: Collection[str]) -> Partitions:
    """Leave out the partitions that another one covers; sorted, in normal form."""
    names = sorted({exact(globs.parse(expression)) for expression in partitions})
    wild = [(name, globs.parse(name)) for name in names if "*" in name]
    return tuple(
        name for name in names if not any(other != name and covers(glob, globs.parse(name)) for other, glob in wild)
    )


@lru_cache(maxsize=4096)
def _within(inner: Partitions, outer: Partitions) -> bool:
    """Tell whether one list of partitions has nothing that another one lacks."""
    return all(name in outer or any(covers(globs.parse(o), globs.parse(name)) for o in outer) for name in inner)


def _left(allowed: Partitions, denied: Partitions) -> Partitions:
    """Return what a deny of ``denied`` (empty: every partition) leaves of a list.

    Raises:
        ValueError: it takes single names out of an expression.
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


def decision_list(
    allow: Sequence[tuple[Glob, Partitions]], deny: Sequence[tuple[Glob, Partitions]]
) -> tuple[Entry, ...]:
    """Return a decision list for patterns with different lists of partitions.

    What is denied in every partition comes before all wildcards that are allowed.

    Raises:
        PartitionError: a deny takes names out of ``*``, or the patterns overlap in too many ways.
    """
    allow = [(pattern, _plain(listed)) for pattern, listed in allow]
    patterns = dict.fromkeys(pattern for pattern, _ in (*allow, *deny))
    literals = sorted(pattern for pattern in patterns if literal(pattern) is not None)
    denials = maximal(pattern for pattern, listed in deny if not listed and literal(pattern) is None)
    narrowed = [pattern for pattern, listed in deny if listed and literal(pattern) is None]
    allowed, denied = _Side.of(allow), _Side.of(deny)
    steps: list[tuple[Glob, Partitions]] = [
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
    return tuple(_entries(_freed(steps)))


def _freed(steps: Iterable[tuple[Glob, Partitions]]) -> list[tuple[Glob, Partitions]]:
    """Return steps with those first that no denial touches, and that overtake no step with other partitions."""
    steps = list(steps)
    denies = [pattern for pattern, listed in steps if not listed]
    free: list[tuple[Glob, Partitions]] = []
    later: list[tuple[Glob, Partitions]] = []
    for pattern, listed in steps:
        overtaken = (other for other, where in later if where != listed)
        touched = any(not disjoint(pattern, other) for other in (*denies, *overtaken))
        (later if touched or not listed else free).append((pattern, listed))
    return [*free, *later]


def _united(wild: Iterable[tuple[Glob, Partitions]], denials: Sequence[Glob]) -> dict[Glob, Partitions]:
    """Return patterns with lists, so that of those that match a name one has all the partitions of the others.

    Two patterns need an intersection of their own only where neither list has all that the other one has.
    """
    found: dict[Glob, Partitions] = {}
    for pattern, listed in wild:
        if not any(covers(denial, pattern) for denial in denials):
            found[pattern] = _reduced(frozenset((*found.get(pattern, ()), *listed)))
    todo = list(found)
    while todo:
        pattern = todo.pop()
        for other in list(found):
            listed, theirs = found[pattern], found[other]
            if _within(listed, theirs) or _within(theirs, listed):
                continue
            both = _reduced(frozenset((*listed, *theirs)))
            for piece in _meeting(pattern, other):
                if any(covers(denial, piece) for denial in denials) or any(
                    _within(both, known) and covers(wider, piece) for wider, known in found.items()
                ):
                    continue
                found[piece] = _reduced(frozenset((*found.get(piece, ()), *both)))
                todo.append(piece)
                _bound(found, piece)
    return found


def _widest_first(found: Mapping[Glob, Partitions]) -> list[tuple[Glob, Partitions]]:
    """Return steps so that none stands after one with fewer partitions, the same on every run."""
    lists = sorted(set(found.values()))
    weight = {listed: sum(_within(other, listed) for other in lists) for listed in lists}
    return sorted(found.items(), key=lambda step: (-weight[step[1]], step[1], sort_key(step[0])))


def _meeting(pattern: Glob, other: Glob) -> tuple[Glob, ...]:
    """Return the pieces of an intersection.

    Raises:
        PartitionError: there are too many.
    """
    try:
        return intersection(pattern, other)
    except TooComplexError:
        raise PartitionError(pattern, "it overlaps with others in too many ways") from None


def _bound(found: Collection[Glob], pattern: Glob) -> None:
    if len(found) > MAX_PATTERNS:
        raise PartitionError(pattern, "patterns with different partitions overlap in too many ways")


def _closed(
    steps: Sequence[tuple[Glob, Partitions]], *, literals_only: bool = False
) -> Iterator[tuple[Glob, Partitions]]:
    """Follow each step by a denial where a later one would allow its names in more partitions.

    With ``literals_only`` the wildcards stand so that each name meets all of its partitions first; a literal may have
    fewer than the wildcards behind it, as a denial of that name took some away.

    Where the topic matches and the partition does not, the standard and Cyclone DDS go on to the next rule. On Fast
    DDS the first rule that names the topic decides alone, so the denial changes nothing there.
    """
    wild = [(at, step) for at, step in enumerate(steps) if literal(step[0]) is None]
    for at, (pattern, listed) in enumerate(steps):
        yield pattern, listed
        if literals_only and literal(pattern) is None:
            continue
        # Literals come first and once, so that only wildcards can be about the same names later.
        wider = (other for place, (other, later) in wild if place > at and not _within(later, listed))
        if listed and listed != EVERY and any(not disjoint(pattern, other) for other in wider):
            yield pattern, ()


def _needed(steps: Sequence[tuple[Glob, Partitions]]) -> list[tuple[Glob, Partitions]]:
    """Leave out the steps without which every name meets the same list."""
    kept: list[tuple[Glob, Partitions]] = []
    wild: list[tuple[Glob, Partitions]] = []
    for step in reversed(steps):
        pattern, listed = step
        following = next((other for other in reversed(wild) if not disjoint(other[0], pattern)), (EVERYTHING, ()))
        if following[1] != listed or not covers(following[0], pattern):
            kept.append(step)
            if literal(pattern) is None:
                wild.append(step)
    return kept[::-1]


@dataclass(frozen=True, slots=True)
class _Side:
    """Patterns with their partitions; the literal ones by themselves, since there may be many."""

    exact: Mapping[Glob, Sequence[Partitions]]
    wild: Sequence[tuple[Glob, Partitions]]

    @classmethod
    def of(cls, items: Iterable[tuple[Glob, Partitions]]) -> Self:
        """Return the side that has these items."""
        exact: dict[Glob, list[Partitions]] = {}
        wild: list[tuple[Glob, Partitions]] = []
        for pattern, listed in items:
            if literal(pattern) is None:
                wild.append((pattern, listed))
            else:
                exact.setdefault(pattern, []).append(listed)
        return cls(exact, wild)

    def covering(self, pattern: Glob) -> Iterator[tuple[Glob, Partitions]]:
        """Yield the items that cover a pattern: a literal one covers only itself.

        Raises:
            TooComplexError: that was not found out.
        """
        for listed in self.exact.get(pattern, ()):
            yield pattern, listed
        for item in self.wild:
            if surely_covers(item[0], pattern):
                yield item


def _effective(pattern: Glob, allow: _Side, deny: _Side) -> Partitions:
    try:
        listed = frozenset(name for _, names in allow.covering(pattern) for name in names)
        denied = list(deny.covering(pattern))
    except TooComplexError:
        raise PartitionError(pattern, "how it overlaps with others is too hard to find out") from None
    left = _reduced(listed)
    for other, names in denied:
        if left:
            try:
                left = _left(left, names)
            except ValueError:
                reason = f"it takes away a part of the partitions {' '.join(left)}, which vendors do not read alike"
                raise PartitionError(other, reason) from None
    return left


def _closure(wild: Sequence[Glob], denials: Sequence[Glob]) -> list[Glob]:
    """Return the patterns and all their intersections, but for what is denied anyway."""
    found = {pattern: None for pattern in wild if not any(covers(denial, pattern) for denial in denials)}
    todo = list(found)
    while todo:
        pattern = todo.pop()
        for other in list(found):
            for piece in _meeting(pattern, other):
                known = any(covers(each, piece) and covers(piece, each) for each in found)
                if piece not in found and not known and not any(covers(denial, piece) for denial in denials):
                    found[piece] = None
                    todo.append(piece)
                _bound(found, piece)
    return list(found)


def _specific_first(patterns: Iterable[Glob]) -> list[Glob]:
    """Return patterns so that none stands after one that covers it, the same on every run."""
    left = sorted(patterns, key=sort_key)
    ordered: list[Glob] = []
    while left:
        ready = [p for p in left if not any(q is not p and covers(p, q) and not covers(q, p) for q in left)]
        ordered += ready
        left = [p for p in left if p not in ready]
    return ordered


def _entries(steps: Iterable[tuple[Glob, Partitions]]) -> list[Entry]:
    """Group steps that may share a rule."""
    entries: list[Entry] = []
    for pattern, listed in steps:
        _append(entries, pattern, listed)
    return entries


def _append(entries: list[Entry], pattern: Glob, listed: Partitions) -> None:
    """Put a pattern into the last entry that it can join without being read later than an overlapping one."""
    effect = Effect.ALLOW if listed else Effect.DENY
    listed = listed or EVERY
    for at in range(len(entries) - 1, -1, -1):
        entry = entries[at]
        if (entry.effect, entry.partitions) == (effect, listed):
            entries[at] = Entry(effect, (*entry.globs, pattern), listed)
            return
        if not all(disjoint(pattern, other) for other in entry.globs):
            break
    entries.append(Entry(effect, (pattern,), listed))
