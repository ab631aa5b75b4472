# SPDX-License-Identifier: Apache-2.0
"""Expressions that depend on the subject, as patterns of words with characters for ``{namespace}`` and ``{name}``.

A subject is ``"/" + namespace + name``: the namespace is empty or ends with ``/``, the name is the last segment. In a
symbolic word one character, a placeholder, represents either. A symbolic word and a subject yield one word. Different
symbolic words may yield the same word, so two patterns can share a word without sharing a symbolic word.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from itertools import cycle

from comarmor.patterns.glob import Glob, literal, normalise, units
from comarmor.patterns.relations import disjoint
from comarmor.patterns.tokens import STAR, Star, Token
from comarmor.values import dataclass
from keymint.analysis.rule_lists import PermissionKey, rule_patterns
from keymint.api import WrittenRule

NAMESPACE = "\x01"
"""Placeholder of the subject's namespace without its leading ``/``. XML cannot contain this character."""
NAME = "\x02"
"""Placeholder of the last segment of the subject."""
PLACEHOLDERS = (NAMESPACE, NAME)
_MOST_PIECES = 256
_Tokens = tuple[Token, ...]
_Piece = tuple[tuple[Glob, ...], tuple[Glob, ...], Glob]
"""Limits of the namespace, limits of the name, and pattern of symbolic words."""


@dataclass(frozen=True, slots=True)
class FittedPattern:
    """A pattern, rewritten for symbolic words with the placeholders of another pattern.

    Attributes:
        pieces: the pieces.
        exact: the pieces match a symbolic word and a subject if and only if the pattern matches the word they yield.
    """

    pieces: tuple[_Piece, ...]
    exact: bool


def symbolic_patterns(clause: WrittenRule, key: PermissionKey, at: int | None = None) -> tuple[Glob, ...]:
    """Return the patterns of symbolic words of a rule, for a kind and permission without parts.

    Args:
        clause: the rule.
        key: the kind and permission.
        at: index of one of its expressions; all by default.
    """
    expressions = clause.expand(f"/{NAMESPACE}/", NAME)[slice(None) if at is None else slice(at, at + 1)]
    return tuple(
        dict.fromkeys(
            pattern
            for expression in expressions
            for pattern in rule_patterns(clause.rule, expression.replace(f"{NAMESPACE}/", NAMESPACE), key)
        )
    )


def placeholders(pattern: Glob) -> tuple[str, ...]:
    """Return the placeholders of a pattern, in order."""
    return tuple(char for token in pattern if isinstance(token, str) for char in token if char in PLACEHOLDERS)


def fill_placeholders(pattern: Glob, namespace: Glob, name: Glob) -> Glob:
    """Return a pattern with its placeholders replaced by patterns of namespace and name."""
    if not placeholders(pattern):
        return pattern
    values = {NAMESPACE: namespace, NAME: name}
    return normalise(
        each
        for token in units(pattern)
        for each in (values.get(token, (token,)) if isinstance(token, str) else (token,))
    )


def exact_halves(subject: str) -> tuple[Glob, Glob]:
    """Return the namespace, without the leading ``/``, and the name of a subject as patterns."""
    head, _, last = subject.removeprefix("/").rpartition("/")
    return (f"{head}/",) if head else (), (last,)


def concrete_name(word: str, namespace: str, name: str) -> str:
    """Return the word that a symbolic word and a subject yield."""
    return word.replace(NAMESPACE, namespace).replace(NAME, name)


def as_written(expression: str) -> str:
    """Return an expression with placeholders as in a policy."""
    return expression.replace(f"/{NAMESPACE}", "{namespace}").replace(NAMESPACE, "{namespace}").replace(NAME, "{name}")


@lru_cache(maxsize=1 << 14)
def fit_pattern(pattern: Glob, shape: Glob, namespace: Glob, name: Glob, *, wide: bool) -> FittedPattern:
    """Rewrite a pattern of symbolic words to the placeholders of another pattern, the shape.

    Args:
        pattern: the pattern.
        shape: a pattern; only its intersection with the first one matters.
        namespace: pattern of the namespaces.
        name: pattern of the last segments.
        wide: over-approximate if the result is not exact; else under-approximate.
    """
    own, other = units(pattern), units(shape)
    head = _common_prefix(own, other)
    tail = _common_prefix(own[head:][::-1], other[head:][::-1])
    end = len(own) - tail
    middle, others = own[head:end], other[head : len(other) - tail]
    if _surely_disjoint(middle, others) or _surely_disjoint(middle[::-1], others[::-1]):
        return FittedPattern((), exact=True)
    values = {NAMESPACE: namespace, NAME: name}
    exact = not _has_placeholder(middle)
    splits_shape = not exact and not _has_placeholder(others)
    if splits_shape:
        # Exact for a single word; else the subject and the word depend on each other.
        exact = literal(normalise(others)) is not None
        if not (exact or wide):
            return FittedPattern((), exact=False)
        split, segments = others, _segments(middle)
    else:
        if not exact and wide:
            middle = units(fill_placeholders(normalise(middle), namespace, name))
        split, segments = middle, _segments(others)
    pieces: dict[_Piece, None] = {}
    for parts in _splits(split, segments, values):
        if len(pieces) == _MOST_PIECES:
            everything = ((), (), shape)
            return FittedPattern((everything,) if wide else tuple(pieces), exact=False)
        limits: dict[str, list[Glob]] = {NAMESPACE: [], NAME: []}
        tokens: list[Token] = [*own[:head]]
        for part, segment, is_placeholder in zip(parts, segments, cycle((False, True)), strict=False):
            tokens += part if splits_shape or not is_placeholder else segment
            if is_placeholder and part not in (segment, (STAR,)):
                limits[str(segment[0])].append(normalise(part))
        pieces[tuple(limits[NAMESPACE]), tuple(limits[NAME]), normalise((*tokens, *own[end:]))] = None
    return FittedPattern(tuple(pieces), exact)


def _common_prefix(one: _Tokens, other: _Tokens) -> int:
    """Return the length of the common literal prefix of two patterns."""
    count = 0
    for token, token2 in zip(one, other, strict=False):
        if token != token2 or not isinstance(token, str):
            break
        count += 1
    return count


def _surely_disjoint(one: _Tokens, other: _Tokens) -> bool:
    """Return True if two patterns begin with different letters, so that they have no common word."""
    if not (one and other and isinstance(one[0], str) and isinstance(other[0], str)):
        return False
    return one[0] not in PLACEHOLDERS and other[0] not in PLACEHOLDERS and one[0] != other[0]


def _segments(shape: _Tokens) -> list[_Tokens]:
    """Return the parts of a pattern between its placeholders (even indices), and the placeholders (odd indices)."""
    segments: list[_Tokens] = [()]
    for token in shape:
        if isinstance(token, str) and token in PLACEHOLDERS:
            segments += [(token,), ()]
        else:
            segments[-1] = (*segments[-1], token)
    return segments


def _splits(pattern: _Tokens, segments: list[_Tokens], values: dict[str, Glob]) -> Iterator[tuple[_Tokens, ...]]:
    """Yield the ways to split a pattern into one part for each segment.

    The part of a placeholder is that placeholder, or a pattern of its value.
    """
    first, rest = segments[0], segments[1:]
    outer = values[str(first[0])] if _has_placeholder(first) else normalise(first)
    for left, right in _cuts(pattern) if rest else ((pattern, ()),):
        if left != first and (_has_placeholder(left) or disjoint(normalise(left), outer)):
            continue
        if not rest:
            yield (left,)
            continue
        for parts in _splits(right, rest, values):
            yield (left, *parts)


def _has_placeholder(pattern: _Tokens) -> bool:
    return any(isinstance(token, str) and token in PLACEHOLDERS for token in pattern)


def _cuts(pattern: _Tokens) -> Iterator[tuple[_Tokens, _Tokens]]:
    """Yield the ways to split a pattern in two.

    A split at a star is inside of it, so both sides get the star; a placeholder is also split off by itself.
    """
    for at in range(len(pattern) + 1):
        left, right = pattern[:at], pattern[at:]
        if right and isinstance(right[0], Star):
            yield pattern[: at + 1], right
        beside_star = any(isinstance(token, Star) for token in (*left[-1:], *right[:1]))
        if not beside_star or _has_placeholder((*left[-1:], *right[:1])):
            yield left, right
