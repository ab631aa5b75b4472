# SPDX-License-Identifier: Apache-2.0
"""Rules for patterns of subjects, as patterns of words with characters for ``{namespace}`` and ``{name}``.

A subject is ``"/" + namespace + name``: the namespace is empty or ends with ``/``, the name is the last segment. In a
symbolic word one character, a placeholder, represents either. A symbolic word and a subject yield one word. Different
symbolic words may yield the same word, so two patterns can share a word without sharing a symbolic word.

:class:`SymbolicRules` has the rules of a policy in this form, as input of :mod:`keymint.analysis.symbolic_search`.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from functools import cache, lru_cache
from itertools import cycle, takewhile

from comarmor.patterns.glob import Glob, left_quotient, literal, normalise, parse, units
from comarmor.patterns.pattern_index import PatternIndex
from comarmor.patterns.relations import TooComplexError, disjoint
from comarmor.patterns.tokens import STAR, Star, Token
from comarmor.rules import Effect
from comarmor.values import Data
from keymint.analysis.rule_lists import PermissionKey, permission_keys, rule_patterns
from keymint.analysis.subject_patterns import (
    EVERY,
    SubjectClass,
    namespace_name_splits,
    profile_chain,
    profile_subjects,
)
from keymint.api import PolicyStructure, WrittenRule
from keymint.errors import Origin

NAMESPACE = "\x01"
"""Placeholder of the subject's namespace without its leading ``/``. XML cannot contain this character."""
NAME = "\x02"
"""Placeholder of the last segment of the subject."""
PLACEHOLDERS = (NAMESPACE, NAME)
_MOST_PIECES = 256
_MOST_OVERLAPS = 8
"""Maximum number of intersections of nested profiles; beyond it the inner profiles become separate conditions."""
_Profiles = tuple[tuple[str, ...], ...]
_Tokens = tuple[Token, ...]
_Piece = tuple[tuple[Glob, ...], tuple[Glob, ...], Glob]
"""Limits of the namespace, limits of the name, and pattern of symbolic words."""


class FittedPattern(Data):
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
    values: dict[Token, Glob] = {NAMESPACE: namespace, NAME: name}
    return normalise(each for token in units(pattern) for each in values.get(token, (token,)))


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
    pairs = zip(one, other, strict=False)
    return sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1] and isinstance(pair[0], str), pairs))


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


class SymbolicEntry(Data):
    """An expression of a rule.

    Attributes:
        subjects: patterns of namespace and name that together match exactly its subjects.
        object: pattern of symbolic words.
    """

    subjects: tuple[tuple[Glob, Glob], ...]
    object: Glob


Entries = tuple[SymbolicEntry, ...]
EVERYBODY = ((STAR,), (STAR,))


def namespace_name_pairs(subjects: Glob) -> tuple[tuple[Glob, Glob], ...]:
    """Return patterns of namespace, without the leading ``/``, and name that together match the same subjects."""
    return tuple(
        dict.fromkeys(
            (rest, name) for space, name in namespace_name_splits(subjects) for rest in left_quotient(space, "/")
        )
    )


class ProfileReach(Data):
    """The subjects that nested profiles match by patterns.

    Attributes:
        subjects: patterns that together match at least them.
        left: expressions of the profiles that ``subjects`` ignores.
        exact: patterns that match exactly them; may be many, and empty if they are too many.
    """

    subjects: tuple[Glob, ...]
    left: _Profiles
    exact: tuple[Glob, ...]

    @property
    def conditions(self) -> tuple[Entries, ...]:
        """The profiles that ``subjects`` ignores: a word matches some entry of each."""
        return tuple(
            tuple(SymbolicEntry(namespace_name_pairs(parse(each)), (STAR,)) for each in level) for level in self.left
        )


class SymbolicRule(Data):
    """An expression of a rule.

    Attributes:
        profiles: expressions of the profiles around the rule, outermost first.
        reach: its subjects.
        object: pattern of symbolic words.
        where: the rule.
    """

    profiles: _Profiles
    reach: ProfileReach
    object: Glob
    where: Origin

    @property
    def content(self) -> tuple[_Profiles, Glob]:
        """The rule without its place."""
        return self.profiles, self.object

    def may_meet(self, objects: Glob, area: SubjectClass) -> bool:
        """Return False if the rule is surely not about some objects, for any of some subjects.

        Args:
            objects: pattern of symbolic words.
            area: the subjects.
        """
        halves = (each for piece in area.overlaps(self.reach.subjects) for each in namespace_name_pairs(piece))
        return any(fit_pattern(self.object, objects, *each, wide=True).pieces for each in halves)

    def entry(self) -> SymbolicEntry:
        """Return the rule as an entry of a condition."""
        subjects = self.reach.exact or self.reach.subjects
        return SymbolicEntry(tuple(pair for one in subjects for pair in namespace_name_pairs(one)), self.object)


class SymbolicRules:
    """The rules of a policy for subjects that its profiles match by patterns.

    Args:
        written: structure of the policy.

    Attributes:
        singles: subjects that profiles match exactly: those that the policy names, and single overlaps of patterns.
        profiles: attachments of each profile and of those around it, by patterns of its subjects.
    """

    def __init__(self, written: PolicyStructure) -> None:
        self.singles: dict[str, None] = {}
        self._by_key: dict[tuple[PermissionKey, Effect], dict[tuple[_Profiles, Glob], SymbolicRule]] = defaultdict(dict)
        self._index = cache(self._indexed)
        self.applying = cache(self._find_applying)
        chains = (*(clause.profiles for clause in written.clauses), *map(profile_chain, written.profiles))
        reaches: dict[_Profiles, ProfileReach] = {}
        for profiles in dict.fromkeys(chains):
            reaches[profiles], singles = profile_reach(profiles)
            self.singles |= dict.fromkeys(singles)
        self.profiles = PatternIndex((one, profiles) for profiles, reach in reaches.items() for one in reach.subjects)
        for clause in written.clauses:
            subjects = reaches[clause.profiles]
            if not subjects.subjects:
                continue
            for key in permission_keys(clause.rule):
                for pattern in symbolic_patterns(clause, key):
                    rule = SymbolicRule(clause.profiles, subjects, pattern, clause.rule.origin)
                    self._by_key[key, clause.rule.effect].setdefault(rule.content, rule)

    def all(self, key: PermissionKey, effect: Effect) -> dict[tuple[_Profiles, Glob], SymbolicRule]:
        """Return the rules of an effect for a kind and permission without parts, by content."""
        return self._by_key.get((key, effect), {})

    def surely(self, key: PermissionKey, effect: Effect, subjects: Glob) -> Entries:
        """Return entries of the rules that may apply to some subjects, without those that are too complex."""
        return tuple(one.entry() for one in self.applying(key, effect, subjects) if one.reach.exact)

    def _find_applying(self, key: PermissionKey, effect: Effect, subjects: Glob) -> tuple[SymbolicRule, ...]:
        """Return the rules that may apply to subjects that a pattern matches."""
        by_profiles, index = self._index(key, effect)
        near = dict.fromkeys(profiles for _, profiles in index.meeting(subjects))
        return tuple(rule for profiles in near for rule in by_profiles[profiles])

    def _indexed(
        self, key: PermissionKey, effect: Effect
    ) -> tuple[dict[_Profiles, list[SymbolicRule]], PatternIndex[_Profiles]]:
        """Return rules by the profiles around them, and these profiles by the patterns of their subjects."""
        by_profiles: dict[_Profiles, list[SymbolicRule]] = defaultdict(list)
        for rule in self.all(key, effect).values():
            by_profiles[rule.profiles].append(rule)
        subjects = ((one, profiles) for profiles, (rule, *_) in by_profiles.items() for one in rule.reach.subjects)
        return by_profiles, PatternIndex(subjects)


def profile_reach(profiles: _Profiles) -> tuple[ProfileReach, tuple[str, ...]]:
    """Return the subjects that nested profiles match by patterns, and those that they match exactly."""
    exact: tuple[Glob, ...] = ()
    for depth in range(len(profiles), 0, -1):
        try:
            patterns = profile_subjects(profiles[:depth])
        except TooComplexError:
            continue
        if depth == len(profiles):
            exact = patterns
        if depth > 1 and len(patterns) > max(_MOST_OVERLAPS, *map(len, profiles)):
            continue
        singles = tuple(name for one in patterns if (name := literal(one)) is not None)
        return ProfileReach(tuple(one for one in patterns if literal(one) is None), profiles[depth:], exact), singles
    return ProfileReach((EVERY,), profiles, ()), ()
