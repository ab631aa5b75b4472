"""Expressions that depend on the subject, as patterns over words in which ``{namespace}`` and ``{name}`` are letters.

A subject is ``"/" + namespace + name``: the namespace is empty or ends with ``/``, the name is the last segment. In a
symbolic word one letter stands for either. A symbolic word and a subject give one word; several symbolic words may give
the same word, so that two patterns can have a word in common although they have no symbolic word in common.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

from comarmor.patterns.glob import Glob, literal, normalise, units
from comarmor.patterns.relations import disjoint
from comarmor.patterns.tokens import STAR, Star, Token
from keymint.analysis.rule_lists import PermissionKey, rule_patterns
from keymint.api import WrittenRule

NAMESPACE = "\x01"
"""Stands for the subject's namespace without its leading ``/``. XML cannot hold this character."""
NAME = "\x02"
"""Stands for the last segment of the subject."""
PLACEHOLDERS = (NAMESPACE, NAME)
_MOST_PIECES = 256
_Tokens = tuple[Token, ...]


@dataclass(frozen=True, slots=True)
class TemplatePiece:
    """Subjects, and the symbolic words that a pattern matches for each of them.

    Attributes:
        namespace: pattern of the namespaces, without the leading ``/``.
        name: pattern of the last segments.
        object: pattern of symbolic words.
    """

    namespace: Glob
    name: Glob
    object: Glob


@dataclass(frozen=True, slots=True)
class FittedPattern:
    """A pattern, said of symbolic words in which the marks stand as in another pattern.

    Attributes:
        pieces: for each, what the namespace and the name must match, and the pattern of symbolic words.
        exact: the pieces match a symbolic word and a subject if and only if the pattern matches the word they give.
    """

    pieces: tuple[tuple[tuple[Glob, ...], tuple[Glob, ...], Glob], ...]
    exact: bool


def symbolic_patterns(clause: WrittenRule, key: PermissionKey) -> tuple[Glob, ...]:
    """Return the patterns of symbolic words that a rule is about, for a kind and permission without parts."""
    expressions = clause.expand(f"/{NAMESPACE}/", NAME)
    return tuple(
        dict.fromkeys(
            pattern
            for expression in expressions
            for pattern in rule_patterns(clause.rule, expression.replace(f"{NAMESPACE}/", NAMESPACE), key)
        )
    )


def placeholders(pattern: Glob) -> tuple[str, ...]:
    """Return the marks of a pattern, in their order."""
    return tuple(char for token in pattern if isinstance(token, str) for char in token if char in PLACEHOLDERS)


def fill_placeholders(pattern: Glob, namespace: Glob, name: Glob) -> Glob:
    """Return a pattern with patterns of the namespace and the name in place of the marks."""
    if not placeholders(pattern):
        return pattern
    values = {NAMESPACE: namespace, NAME: name}
    return normalise(
        each
        for token in units(pattern)
        for each in (values.get(token, (token,)) if isinstance(token, str) else (token,))
    )


def concrete_name(word: str, namespace: str, name: str) -> str:
    """Return the word that a symbolic word and a subject give."""
    return word.replace(NAMESPACE, namespace).replace(NAME, name)


def as_written(expression: str) -> str:
    """Return an expression with marks as a policy writes it."""
    return expression.replace(f"/{NAMESPACE}", "{namespace}").replace(NAMESPACE, "{namespace}").replace(NAME, "{name}")


@lru_cache(maxsize=1 << 14)
def fit_pattern(pattern: Glob, shape: Glob, namespace: Glob, name: Glob, *, wide: bool) -> FittedPattern:
    """Say a pattern of symbolic words where the marks stand as in another pattern, the shape.

    Args:
        pattern: the pattern.
        shape: a pattern; only what it has in common with the first one matters.
        namespace: matches the namespaces in question.
        name: matches the last segments in question.
        wide: where the answer is not exact it matches too much, else too little.
    """
    mine, other = units(pattern), units(shape)
    head = _common_prefix(mine, other)
    tail = _common_prefix(mine[head:][::-1], other[head:][::-1])
    end, end2 = len(mine) - tail, len(other) - tail
    if _surely_disjoint(mine[head:end], other[head:end2]) or _surely_disjoint(
        mine[head:end][::-1], other[head:end2][::-1]
    ):
        return FittedPattern((), exact=True)
    exact = True
    middle, others = mine[head:end], other[head:end2]
    if _has_placeholder(middle) and not _has_placeholder(others):
        return _fit_concrete_shape(
            mine[:head], middle, others, mine[end:], {NAMESPACE: namespace, NAME: name}, wide=wide
        )
    if _has_placeholder(middle):
        exact = False
        if wide:
            middle = units(fill_placeholders(normalise(middle), namespace, name))
    segments = _segments(other[head:end2])
    found: dict[tuple[tuple[Glob, ...], tuple[Glob, ...], Glob], None] = {}
    for parts in _splits(middle, segments, {NAMESPACE: namespace, NAME: name}):
        if len(found) == _MOST_PIECES:
            whole = ((), (), shape)
            return FittedPattern((whole,) if wide else tuple(found), exact=False)
        limits: dict[str, list[Glob]] = {NAMESPACE: [], NAME: []}
        tokens: list[Token] = [*mine[:head]]
        for at, part in enumerate(parts):
            if at % 2 == 0:
                tokens += part
                continue
            mark = segments[at][0]
            tokens.append(mark)
            limit = normalise(part)
            if limit not in ((mark,), (STAR,)):
                limits[str(mark)].append(limit)
        pattern_ = normalise((*tokens, *mine[end:]))
        found[tuple(limits[NAMESPACE]), tuple(limits[NAME]), pattern_] = None
    return FittedPattern(tuple(found), exact)


def _fit_concrete_shape(
    head: _Tokens, middle: _Tokens, shape: _Tokens, tail: _Tokens, values: dict[str, Glob], *, wide: bool
) -> FittedPattern:
    """Say a pattern with marks of words without: cut the shape where the marks stand, to tell what they must be.

    That is exact if the shape is one word; else the subject and the word depend on each other.
    """
    exact = literal(normalise(shape)) is not None
    if not (exact or wide):
        return FittedPattern((), exact=False)
    segments = _segments(middle)
    found: dict[tuple[tuple[Glob, ...], tuple[Glob, ...], Glob], None] = {}
    for parts in _splits(shape, segments, values):
        if len(found) == _MOST_PIECES:
            all_ = ((), (), normalise((*head, *shape, *tail)))
            return FittedPattern((all_,) if wide else tuple(found), exact=False)
        limits: dict[str, list[Glob]] = {NAMESPACE: [], NAME: []}
        for at in range(1, len(parts), 2):
            limits[str(segments[at][0])].append(normalise(parts[at]))
        whole = normalise((*head, *(token for part in parts for token in part), *tail))
        found[tuple(limits[NAMESPACE]), tuple(limits[NAME]), whole] = None
    return FittedPattern(tuple(found), exact)


def _common_prefix(one: _Tokens, other: _Tokens) -> int:
    """Return how many letters two patterns begin with alike."""
    count = 0
    for mine, theirs in zip(one, other, strict=False):
        if mine != theirs or not isinstance(mine, str):
            break
        count += 1
    return count


def _surely_disjoint(one: _Tokens, other: _Tokens) -> bool:
    """Tell whether two patterns begin with different letters, so that they have no word in common."""
    if not (one and other and isinstance(one[0], str) and isinstance(other[0], str)):
        return False
    return one[0] not in PLACEHOLDERS and other[0] not in PLACEHOLDERS and one[0] != other[0]


def _segments(shape: _Tokens) -> list[_Tokens]:
    """Return the parts of a pattern between its marks, and the marks: at even places parts, at odd ones marks."""
    found: list[_Tokens] = [()]
    for token in shape:
        if isinstance(token, str) and token in PLACEHOLDERS:
            found += [(token,), ()]
        else:
            found[-1] = (*found[-1], token)
    return found


def _splits(pattern: _Tokens, segments: list[_Tokens], values: dict[str, Glob]) -> Iterator[tuple[_Tokens, ...]]:
    """Yield the ways to cut a pattern into as many parts as there are segments.

    A part that belongs to a mark is that mark, or a pattern of what it stands for.
    """
    first, rest = segments[0], segments[1:]
    mark = first[0] if len(first) == 1 and isinstance(first[0], str) and first[0] in PLACEHOLDERS else None
    outer = values[str(mark)] if mark else normalise(first)
    for left, right in _cuts(pattern) if rest else ((pattern, ()),):
        if left != (mark,) and (_has_placeholder(left) or disjoint(normalise(left), outer)):
            continue
        if not rest:
            yield (left,)
            continue
        for parts in _splits(right, rest, values):
            yield (left, *parts)


def _has_placeholder(pattern: _Tokens) -> bool:
    return any(isinstance(token, str) and token in PLACEHOLDERS for token in pattern)


def _cuts(pattern: _Tokens) -> Iterator[tuple[_Tokens, _Tokens]]:
    """Yield the ways to cut a pattern in two.

    Beside a star the cut is in it, so that both sides have it; a mark is also cut off by itself.
    """
    for at in range(len(pattern) + 1):
        left, right = pattern[:at], pattern[at:]
        if right and isinstance(right[0], Star):
            yield pattern[: at + 1], right
        beside_star = any(isinstance(token, Star) for token in (*left[-1:], *right[:1]))
        if not beside_star or _has_placeholder((*left[-1:], *right[:1])):
            yield left, right
