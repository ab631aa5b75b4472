"""What sets of names have to do with one another: match, overlap, cover, intersect.

Answers are exact, but for one: whether a pattern is covered is found out by determinising lazily, within a budget. When
it is spent, :func:`covers` and :func:`union_covers` say False ("not shown"), which their callers must be able to take
without harm, and :func:`surely_covers` raises. All of them count their steps (:mod:`comarmor.patterns.steps`).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from comarmor.patterns.glob import EVERYTHING, Glob, is_empty, literal, normalise, prefix, suffix, units
from comarmor.patterns.matching import matcher
from comarmor.patterns.steps import StepLimitError, cached, spend, step_limit
from comarmor.patterns.tokens import ANY, MAX_CODE, STAR, Charset, Star, Token

BUDGET = 2_000
"""States that a question about covering may visit."""
INTERSECTION = 200_000
"""Steps that an intersection may take."""


class TooComplexError(Exception):
    """An intersection has more pieces than a caller can use."""


def disjoint(left: Glob, right: Glob) -> bool:
    """Tell whether no name is matched by both."""
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
    """Tell whether no name is matched by one of the first and one of the second; quick for many literals."""
    exact, wild = _parted(lefts)
    exact2, wild2 = _parted(rights)
    if not exact.isdisjoint(exact2):
        return False
    pairs = ((glob, names) for globs, names in ((wild, exact2), (wild2, exact)) for glob in globs)
    if any(accepts(name) for glob, names in pairs for accepts in (matcher(glob),) for name in names):
        return False
    return all(disjoint(left, right) for left in wild for right in wild2)


def _parted(globs: Iterable[Glob]) -> tuple[set[str], list[Glob]]:
    """Return the names of literal globs, and the other globs."""
    exact: set[str] = set()
    wild: list[Glob] = []
    for glob in globs:
        if (text := literal(glob)) is None:
            wild.append(glob)
        else:
            exact.add(text)
    return exact, wild


@cached(1 << 14)
def _disjoint(left: Glob, right: Glob) -> bool:
    """Search the product of the two for a pair of ends."""
    if is_empty(left) or is_empty(right):
        return True
    first, second = (*units(left), None), (*units(right), None)
    todo = [(0, 0)]
    seen = {(0, 0)}
    while todo:
        spend()
        at, at2 = todo.pop()
        if first[at] is None and second[at2] is None:
            return False
        for step in _common_steps(first[at], second[at2]):
            place = (at + step[0], at2 + step[1])
            if place not in seen:
                seen.add(place)
                todo.append(place)
    return True


def _common_steps(token: Token | None, token2: Token | None) -> Iterator[tuple[int, int]]:
    """Yield how far two patterns can go on by the same character, or by none; None is the end of a pattern."""
    if isinstance(token, Star):
        yield 1, 0
        if token2 is not None:
            yield 0, 1
    elif isinstance(token2, Star):
        yield 0, 1
        if token is not None:
            yield 1, 0
    elif token is not None and token2 is not None and _meet(token, token2) is not None:
        yield 1, 1


def _meet(token: Token, token2: Token) -> Token | None:
    """Return the characters that two tokens of one character have in common, or None."""
    if isinstance(token, str):
        return token if (token == token2 if isinstance(token2, str) else token in token2) else None  # type: ignore[operator]
    if isinstance(token2, str):
        return token2 if token2 in token else None  # type: ignore[operator]
    both = token.intersection(token2)  # type: ignore[union-attr, arg-type]
    return both if both.ranges else None


def covers(outer: Glob, inner: Glob) -> bool:
    """Tell whether ``outer`` is shown to match every name that ``inner`` matches; False where that is not known."""
    return bool(_covers(outer, inner))


def surely_covers(outer: Glob, inner: Glob) -> bool:
    """Tell whether ``outer`` matches every name that ``inner`` matches.

    Raises:
        TooComplexError: that was not found out within the budget.
    """
    found = _covers(outer, inner)
    if found is None:
        raise TooComplexError
    return found


def _covers(outer: Glob, inner: Glob) -> bool | None:
    spend()
    text = literal(inner)
    if text is not None:
        return matcher(outer)(text)
    if outer == EVERYTHING or is_empty(inner):
        return True
    # Beyond its literal prefix (or before its suffix) a normalised glob has at least two different characters.
    if not (prefix(inner).startswith(prefix(outer)) and suffix(inner).endswith(suffix(outer))):
        return False
    match outer:
        case (str(), Star()) | (Star(), str()):
            return True
    return literal(outer) is None and _union_covers((outer,), inner, BUDGET)


def union_covers(outers: tuple[Glob, ...], inner: Glob, budget: int = BUDGET) -> bool:
    """Tell whether it is shown that every name that ``inner`` matches is matched by one of ``outers``.

    Args:
        outers: globs.
        inner: a glob.
        budget: how many states may be visited; when it is spent the answer is False.
    """
    return bool(_union_covers(outers, inner, budget))


@cached(1 << 14)
def _union_covers(outers: tuple[Glob, ...], inner: Glob, budget: int) -> bool | None:
    if is_empty(inner):
        return True
    if (text := literal(inner)) is not None:
        return any(matcher(outer)(text) for outer in outers)
    rows = tuple(units(outer) for outer in outers if not disjoint(outer, inner))
    return _included(units(inner), rows, budget) if rows else False


def _included(goal: tuple[Token, ...], rows: tuple[tuple[Token, ...], ...], budget: int) -> bool | None:
    """Walk through the goal, and beside it through the subsets of places that the rows can be at."""
    letters = _letters((*rows, goal))
    start = frozenset((row, at) for row in range(len(rows)) for at in _closure(rows[row], 0))
    todo = [(at, start) for at in _closure(goal, 0)]
    seen = set(todo)
    while todo:
        at, state = todo.pop()
        spend(1 + len(state))
        if at == len(goal):
            if not any(place == len(rows[row]) for row, place in state):
                return False
            continue
        following = _closure(goal, at if isinstance(goal[at], Star) else at + 1)
        for letter in letters:
            if not _accepts(goal[at], letter):
                continue
            after = frozenset(place for row, here in state for place in _step(rows[row], row, here, letter))
            if not after:
                return False
            new = {(place, after) for place in following} - seen
            if len(seen) + len(new) > budget:
                return None
            seen |= new
            todo += new
    return True


def _closure(row: tuple[Token, ...], at: int) -> list[int]:
    """Return the places that are reached from one without reading a character."""
    places = [at]
    while at < len(row) and isinstance(row[at], Star):
        at += 1
        places.append(at)
    return places


def _step(row: tuple[Token, ...], number: int, at: int, letter: str) -> Iterable[tuple[int, int]]:
    if at == len(row) or not _accepts(row[at], letter):
        return ()
    after = at if isinstance(row[at], Star) else at + 1
    return ((number, place) for place in _closure(row, after))


def _accepts(token: Token, letter: str) -> bool:
    if isinstance(token, str):
        return token == letter
    return isinstance(token, Star) or letter in token


def _letters(rows: Iterable[tuple[Token, ...]]) -> tuple[str, ...]:
    """Return one character of each class that the tokens tell apart."""
    edges = {0}
    for row in rows:
        for token in row:
            if isinstance(token, str):
                edges.update((ord(token), ord(token) + 1))
            elif isinstance(token, Charset):
                for low, high in token.ranges:
                    edges.update((low, high + 1))
    kinds: dict[tuple[bool, ...], str] = {}
    tokens = list(dict.fromkeys(token for row in rows for token in row if not isinstance(token, Star)))
    spend(len(edges) * len(tokens) // 8)
    for edge in sorted(edge for edge in edges if edge <= MAX_CODE):
        kinds.setdefault(tuple(_accepts(token, chr(edge)) for token in tokens), chr(edge))
    return tuple(kinds.values())


def intersection(left: Glob, right: Glob, limit: int = 64) -> tuple[Glob, ...]:
    """Return globs whose union is the set of names that both match.

    Intersections of such patterns are finite unions of such patterns (level 1/2 of the dot-depth hierarchy is closed
    under intersection: J.-E. Pin, "Syntactic semigroups", 1997).

    Raises:
        TooComplexError: there are more than ``limit`` pieces, or more than :data:`INTERSECTION` steps are needed.
    """
    found = _intersection(left, right, limit)
    if found is None:
        raise TooComplexError
    return found


@cached(1 << 12)
def _intersection(left: Glob, right: Glob, limit: int) -> tuple[Glob, ...] | None:
    """Return the pieces of an intersection, or None where there are too many, which is remembered as well."""
    with step_limit(INTERSECTION) as effort:
        try:
            return _pieces(left, right, limit)
        except TooComplexError:
            return None
        except StepLimitError:
            if effort.reported == INTERSECTION:
                return None
            raise


def _pieces(left: Glob, right: Glob, limit: int) -> tuple[Glob, ...]:
    if disjoint(left, right):
        return ()
    if covers(left, right):
        return (right,)
    if covers(right, left):
        return (left,)
    first, second = (*units(left), None), (*units(right), None)
    pieces: dict[tuple[int, int], set[Glob]] = {}
    for at in reversed(range(len(first))):
        for at2 in reversed(range(len(second))):
            token, token2 = first[at], second[at2]
            found: set[Glob] = {()} if token is None and token2 is None else set()
            for step in _common_steps(token, token2):
                # By a step that both make, or that one makes under the other's star, a token is read.
                read = _read(token, token2, step)
                following = pieces[at + step[0], at2 + step[1]]
                spend(1 + 4 * len(following))
                found.update(normalise((*read, *rest)) for rest in following)
            pieces[at, at2] = found if len(found) <= limit else set(maximal(found))
            if len(pieces[at, at2]) > limit:
                raise TooComplexError
    return tuple(maximal(pieces[0, 0]))


def _read(token: Token | None, token2: Token | None, step: tuple[int, int]) -> tuple[Token, ...]:
    """Return what two patterns read together in a step of :func:`_common_steps`."""
    if isinstance(token, Star) and isinstance(token2, Star):
        return (STAR,)
    if isinstance(token, Star):
        return (token2,) if step == (0, 1) and token2 is not None else ()
    if isinstance(token2, Star):
        return (token,) if step == (1, 0) and token is not None else ()
    both = _meet(token, token2) if token is not None and token2 is not None else None
    return () if both is None else (both,)


def maximal(globs: Iterable[Glob]) -> list[Glob]:
    """Return the globs that no other of them covers, one for each set of equals, in a stable order."""
    # What covers a glob has a prefix of its literal prefix, so that few need to be compared.
    kept: dict[str, list[Glob]] = {}
    for glob in sorted(dict.fromkeys(globs), key=lambda glob: (len(prefix(glob)), sort_key(glob))):
        head = prefix(glob)
        wider = (other for end in range(len(head) + 1) for other in kept.get(head[:end], ()))
        if not is_empty(glob) and not any(covers(other, glob) for other in wider):
            kept[head] = [*(other for other in kept.get(head, ()) if not covers(glob, other)), glob]
    return sorted((glob for bucket in kept.values() for glob in bucket), key=sort_key)


def sort_key(glob: Glob) -> str:
    """Return a text by which globs are sorted, the same on every run and machine; NUL marks what is not literal."""
    if (text := literal(glob)) is not None:
        return text
    return "".join(
        token
        if isinstance(token, str)
        else "\0*"
        if isinstance(token, Star)
        else "\0?"
        if token == ANY
        else f"\0{token.ranges}"
        for token in glob
    )
