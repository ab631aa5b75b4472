# SPDX-License-Identifier: Apache-2.0
"""Relations between patterns: disjointness, inclusion, intersection.

Answers are exact, except for inclusion, which is searched up to a number of states: where these do not suffice,
:func:`covers` and :func:`union_covers` return False and :func:`exactly_covers` raises. All functions count their steps
(:mod:`comarmor.patterns.steps`).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from comarmor.patterns.glob import Glob, is_empty, literal, matcher, normalise, prefix, sort_key, suffix, units
from comarmor.patterns.steps import StepLimitError, spend, step_counting_cache, step_limit
from comarmor.patterns.tokens import STAR, Charset, Star, Token

MAX_STATES = 2_000
"""Most states that a test of inclusion visits."""
MAX_INTERSECTION_STEPS = 200_000
"""Most steps that an intersection takes."""


class TooComplexError(Exception):
    """An exact answer needs more states, steps or patterns than are allowed."""


def disjoint(left: Glob, right: Glob) -> bool:
    """Return whether no name matches both patterns."""
    spend()
    text = literal(left)
    if text is not None:
        return not matcher(right)(text)
    text = literal(right)
    if text is not None:
        return not matcher(left)(text)
    return ends_differ(left, right) or _disjoint(left, right)


def ends_differ(left: Glob, right: Glob) -> bool:
    """Return whether the prefixes or the suffixes of two patterns show that they are disjoint."""
    head, head2 = prefix(left), prefix(right)
    if not (head.startswith(head2) or head2.startswith(head)):
        return True
    tail, tail2 = suffix(left), suffix(right)
    return not (tail.endswith(tail2) or tail2.endswith(tail))


def all_disjoint(lefts: Iterable[Glob], rights: Iterable[Glob]) -> bool:
    """Return whether no name matches patterns of both groups; fast for many literals."""
    names, wild = _split(lefts)
    names2, wild2 = _split(rights)
    if not names.isdisjoint(names2):
        return False
    for globs, others in ((wild, names2), (wild2, names)):
        if any(any(map(matcher(glob), others)) for glob in globs):
            return False
    return all(disjoint(left, right) for left in wild for right in wild2)


def _split(globs: Iterable[Glob]) -> tuple[set[str], list[Glob]]:
    """Return the names of the literal patterns, and the other patterns."""
    texts = {glob: literal(glob) for glob in globs}
    names = {text for text in texts.values() if text is not None}
    return names, [glob for glob, text in texts.items() if text is None]


@step_counting_cache
def _disjoint(left: Glob, right: Glob) -> bool:
    """Search the product automaton for a pair of final positions."""
    if is_empty(left) or is_empty(right):
        return True
    first, second = (*units(left), None), (*units(right), None)
    todo = [(0, 0)]
    seen = {(0, 0)}
    while todo:
        spend()
        i, j = todo.pop()
        if first[i] is None and second[j] is None:
            return False
        for step, step2, _ in _common_steps(first[i], second[j]):
            state = (i + step, j + step2)
            if state not in seen:
                seen.add(state)
                todo.append(state)
    return True


def _common_steps(token: Token | None, token2: Token | None) -> Iterator[tuple[int, int, tuple[Token, ...]]]:
    """Yield the steps that two patterns can take by one common character or none; None is the end of a pattern.

    Each with the token that is read: by both, or by one while the other one stays at its ``*``.
    """
    if isinstance(token, Star):
        yield 1, 0, (STAR,) if isinstance(token2, Star) else ()
        if token2 is not None:
            yield 0, 1, (token2,)
    elif isinstance(token2, Star):
        yield 0, 1, ()
        if token is not None:
            yield 1, 0, (token,)
    elif token is not None and token2 is not None and (both := _meet(token, token2)) is not None:
        yield 1, 1, (both,)


def _meet(token: Token, token2: Token) -> Token | None:
    """Return the intersection of two tokens that match one character, or None if it is empty."""
    if isinstance(token, str):
        return token if (token == token2 if isinstance(token2, str) else token in token2) else None  # type: ignore[operator]
    if isinstance(token2, str):
        return token2 if token2 in token else None  # type: ignore[operator]
    both = token.intersection(token2)  # type: ignore[union-attr, arg-type]
    return both if both.ranges else None


def covers(outer: Glob, inner: Glob) -> bool:
    """Sound, incomplete inclusion test: whether ``outer`` matches all that ``inner`` matches; False means unknown."""
    return bool(_covers(outer, inner))


def exactly_covers(outer: Glob, inner: Glob) -> bool:
    """Return whether ``outer`` matches every name that ``inner`` matches.

    Raises:
        TooComplexError: this was not decided within :data:`MAX_STATES`.
    """
    covered = _covers(outer, inner)
    if covered is None:
        raise TooComplexError
    return covered


def _covers(outer: Glob, inner: Glob) -> bool | None:
    """Return whether ``outer`` covers ``inner``, or None if this was not decided."""
    spend()
    text = literal(inner)
    if text is not None:
        return matcher(outer)(text)
    if is_empty(inner):
        return True
    # After its literal prefix (or before its suffix) a normalised pattern matches at least two different characters.
    if not (prefix(inner).startswith(prefix(outer)) and suffix(inner).endswith(suffix(outer))):
        return False
    match outer:
        case (Star(),) | (str(), Star()) | (Star(), str()):
            return True
    return literal(outer) is None and _union_covers((outer,), inner)


def union_covers(outers: tuple[Glob, ...], inner: Glob) -> bool:
    """Sound, incomplete inclusion test: whether patterns together match all that ``inner`` matches."""
    return bool(_union_covers(outers, inner))


@step_counting_cache
def _union_covers(outers: tuple[Glob, ...], inner: Glob) -> bool | None:
    if inner in outers or is_empty(inner):
        return True
    if (text := literal(inner)) is not None:
        return any(matcher(outer)(text) for outer in outers)
    near = tuple(outer for outer in outers if not disjoint(outer, inner))
    if not near:
        return False
    # Search for a word that only the inner one matches. Few questions get here, and most runs have none.
    from comarmor.patterns.decision_lists import EVERY_WORD, BudgetError, SearchBudget  # noqa: PLC0415
    from comarmor.patterns.derivatives import CubeSearch, Derivatives  # noqa: PLC0415

    tokens = dict.fromkeys(token for each in (*near, inner) for token in units(each))
    ranges = sum(len(token.ranges) for token in tokens if isinstance(token, Charset))
    spend(len(tokens) * (len(tokens) + ranges) // 4)  # the letters that they distinguish are found without a count
    derivatives = Derivatives((inner, *near), EVERY_WORD)
    search = CubeSearch(derivatives, (inner,), near, SearchBudget(MAX_STATES).state_counter())
    try:
        return search.shortest(None) is None
    except BudgetError:
        return None


def intersection(left: Glob, right: Glob, limit: int = 64) -> tuple[Glob, ...]:
    """Return patterns whose union matches the names that both patterns match.

    Intersections of such patterns are finite unions of such patterns (level 1/2 of the dot-depth hierarchy is closed
    under intersection: J.-E. Pin, "Syntactic semigroups", 1997).

    Raises:
        TooComplexError: more than ``limit`` patterns or :data:`MAX_INTERSECTION_STEPS` steps are needed.
    """
    pieces = _intersection(left, right, limit)
    if pieces is None:
        raise TooComplexError
    return pieces


@step_counting_cache
def _intersection(left: Glob, right: Glob, limit: int) -> tuple[Glob, ...] | None:
    """Return the patterns of an intersection, or None if it is too complex (so that this is cached as well)."""
    with step_limit(MAX_INTERSECTION_STEPS) as counter:
        try:
            return _pieces(left, right, limit)
        except StepLimitError:
            if counter.reported == MAX_INTERSECTION_STEPS:
                return None
            raise


def _pieces(left: Glob, right: Glob, limit: int) -> tuple[Glob, ...] | None:
    if disjoint(left, right):
        return ()
    if covers(left, right):
        return (right,)
    if covers(right, left):
        return (left,)
    first, second = (*units(left), None), (*units(right), None)
    rests: dict[tuple[int, int], set[Glob]] = {}
    for i in reversed(range(len(first))):
        for j in reversed(range(len(second))):
            token, token2 = first[i], second[j]
            patterns: set[Glob] = {()} if token is None and token2 is None else set()
            for step, step2, read in _common_steps(token, token2):
                following = rests[i + step, j + step2]
                spend(1 + 4 * len(following))
                patterns.update(normalise((*read, *rest)) for rest in following)
            rests[i, j] = patterns if len(patterns) <= limit else set(maximal(patterns))
            if len(rests[i, j]) > limit:
                return None
    return tuple(maximal(rests[0, 0]))


def maximal(globs: Iterable[Glob]) -> list[Glob]:
    """Return the patterns that no other one covers, one of several equal ones, sorted."""
    # The literal prefix of a wider pattern is a prefix of the narrower one's: few need to be compared.
    kept: dict[str, list[Glob]] = {}
    for glob in sorted(dict.fromkeys(globs), key=lambda glob: (len(prefix(glob)), sort_key(glob))):
        head = prefix(glob)
        wider = (other for end in range(len(head) + 1) for other in kept.get(head[:end], ()))
        if not is_empty(glob) and not any(covers(other, glob) for other in wider):
            kept[head] = [*(other for other in kept.get(head, ()) if not covers(glob, other)), glob]
    return sorted((glob for bucket in kept.values() for glob in bucket), key=sort_key)
