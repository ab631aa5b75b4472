r"""Questions about all subjects at once that a policy does not name.

A word is ``namespace NUL name NUL object``; the object is symbolic (:mod:`keymint.analysis.subject_templates`). Rules
are patterns of such words: nested profiles a product, never a list of subjects. "There is none" is proven. A subject
that is found is judged by the rules that the policy has for it. Sound, incomplete: it may say unknown where patterns
that depend on the subject meet by chance.
"""

from __future__ import annotations

import string
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import product

from comarmor.patterns.decision_lists import Block, DecisionList, Equal, Universe, Unknown
from comarmor.patterns.glob import Glob, after, literal, normalise, parse
from comarmor.patterns.matching import matches
from comarmor.patterns.proofs import difference
from comarmor.patterns.relations import TooComplexError, intersection
from comarmor.patterns.tokens import STAR, Charset, Star, charset
from keymint.analysis.query_budget import QueryBudget
from keymint.analysis.rule_lists import RAW, SEPARATOR, universe
from keymint.analysis.subject_patterns import namespace_name_splits
from keymint.analysis.subject_templates import (
    NAME,
    NAMESPACE,
    PLACEHOLDERS,
    TemplatePiece,
    concrete_name,
    fill_placeholders,
    fit_pattern,
    placeholders,
)

_SPELLED = 16
"""Namespaces, or names, that are taken one by one where a pattern matches so few."""
_ROUNDS = 16
"""Candidates that are judged before the answer is unknown."""
_LETTERS = charset((ord(char), ord(char)) for char in string.ascii_letters + string.digits + "_")
_NAMES = charset((*_LETTERS.ranges, (ord("/"), ord("/"))))
_MARKED = charset((*_NAMES.ranges, (ord(NAMESPACE), ord(NAMESPACE)), (ord(NAME), ord(NAME))))
_DIGITS = "[0-9]"


@dataclass(frozen=True, slots=True)
class SymbolicEntry:
    """An expression of a rule.

    Attributes:
        subjects: namespaces and names of the subjects that it is about; together they match these, and no others.
        object: pattern of symbolic words.
    """

    subjects: tuple[tuple[Glob, Glob], ...]
    object: Glob


EVERYBODY = ((STAR,), (STAR,))


@dataclass(frozen=True, slots=True)
class SymbolicCondition:
    """What a word must be like.

    Attributes:
        none: no word of these.
        some: a word of any of these; None if there is no such condition.
    """

    none: tuple[SymbolicEntry, ...] = ()
    some: tuple[SymbolicEntry, ...] | None = None


@dataclass(frozen=True, slots=True)
class FoundSubject:
    """A subject, as was asked for."""

    subject: str


@dataclass(frozen=True, slots=True)
class Undecided:
    """It was not found out whether there is one, and why."""

    reason: str


SubjectCheck = Callable[[str], "bool | Undecided"]
"""Tells whether a subject is as was asked for: exactly, by its own rules."""


def namespace_name_pairs(subjects: Glob) -> tuple[tuple[Glob, Glob], ...]:
    """Return patterns of namespace (without the leading ``/``) and name that together match the same subjects."""
    return tuple(
        dict.fromkeys(
            (rest, name) for namespace, name in namespace_name_splits(subjects) for rest in after(namespace, "/")
        )
    )


def find_subject(
    kind: str,
    subjects: Glob,
    shape: Glob,
    conditions: Sequence[SymbolicCondition],
    judge: SubjectCheck,
    excluded: Iterable[str],
    budget: QueryBudget,
) -> FoundSubject | Undecided | None:
    """Return a subject for which some word is as was asked for; None if there is none.

    Args:
        kind: kind of the objects.
        subjects: pattern of the subjects in question.
        shape: pattern of the symbolic words in question.
        conditions: the word must be like all of them.
        judge: judges each candidate.
        excluded: subjects that do not count.
        budget: pays for it.
    """
    excluded = tuple(excluded)
    undecided: Undecided | None = None
    for namespace, name in _singled(namespace_name_pairs(subjects), placeholders(shape)):
        found = _Search(kind, namespace, name, shape, conditions, budget).run(judge, excluded)
        if isinstance(found, FoundSubject):
            return found
        undecided = undecided or found
    return undecided


def _singled(subjects: Iterable[tuple[Glob, Glob]], used: Sequence[str]) -> Iterator[tuple[Glob, Glob]]:
    """Yield pairs of which a half that is used, and matches few words, matches one."""
    for namespace, name in subjects:
        halves = (_words(namespace) if NAMESPACE in used else None, _words(name) if NAME in used else None)
        yield from product(halves[0] or (namespace,), halves[1] or (name,))


@lru_cache(maxsize=1 << 12)
def _words(pattern: Glob) -> tuple[Glob, ...] | None:
    """Return the words that a pattern matches, if they are few."""
    count = 1
    for token in pattern:
        if isinstance(token, Star):
            return None
        count *= len(token) if isinstance(token, Charset) else 1
    if not 0 < count <= _SPELLED:
        return None
    choices = [token.chars() if isinstance(token, Charset) else (token,) for token in pattern]
    return tuple(normalise(each) for each in product(*choices))


class _Search:
    """The search among subjects whose namespace and name two patterns match."""

    def __init__(
        self,
        kind: str,
        namespace: Glob,
        name: Glob,
        shape: Glob,
        conditions: Sequence[SymbolicCondition],
        budget: QueryBudget,
    ) -> None:
        self._kind = kind
        self._namespace, self._name = namespace, name
        self._shape = self._fixed(shape, namespace, name)
        self._conditions = conditions
        self._budget = budget
        self._universe = Universe(_alphabet(kind), 4 if kind == RAW else 3, SEPARATOR, last_nonempty=kind == RAW)

    def run(self, judge: SubjectCheck, excluded: Iterable[str]) -> FoundSubject | Undecided | None:
        """Ask, judge what is found, and ask again without it; see :func:`find_subject`."""
        try:
            positives, negatives = self._lists()
        except TooComplexError:
            return Undecided("its patterns have too much in common to be told apart")
        refused = [*negatives, *map(self._subject, excluded)]
        for _ in range(_ROUNDS):
            denied = Block(False, tuple(dict.fromkeys(refused)))
            lists: list[DecisionList] = [
                (denied, Block(True, positives[0])),
                *((Block(True, each),) for each in positives[1:]),
            ]
            if self._budget.is_empty:
                return Undecided(self._budget.reason(""))
            outcome = difference((), *lists, universe=self._universe, budget=self._budget.next_query(len(lists)))
            if isinstance(outcome, Equal):
                return None
            if isinstance(outcome, Unknown):
                return Undecided(self._budget.reason(outcome.reason))
            namespace, name, word = outcome.word.split(SEPARATOR, 2)
            subject = f"/{namespace}{name}"
            judged = judge(subject)
            if judged is not False:
                return FoundSubject(subject) if judged is True else judged
            refused += [self._subject(subject), *self._met(namespace, name, concrete_name(word, namespace, name))]
        return Undecided(
            "rules that depend on {namespace} or {name} meet others, and no subject was found that shows a difference"
        )

    def _lists(self) -> tuple[list[tuple[Glob, ...]], list[Glob]]:
        """Return, for each condition, the words of which it must be one; and words that it must not be."""
        positives: list[tuple[Glob, ...]] = [(_word(self._namespace, self._name, self._shape),)]
        negatives = [*_illegal(self._kind), *self._miscounted()]
        for condition in self._conditions:
            if condition.some is not None:
                some = (piece for entry in condition.some for piece in self._pieces(entry, wide=True))
                positives.append(tuple(dict.fromkeys(_word(each.namespace, each.name, each.object) for each in some)))
            for entry in condition.none:
                negatives += (_word(p.namespace, p.name, p.object) for p in self._pieces(entry, wide=False))
        return positives, negatives

    def _pieces(self, entry: SymbolicEntry, *, wide: bool) -> Iterator[TemplatePiece]:
        """Yield an entry as patterns of words; they match too much (wide), or too little."""
        for theirs in entry.subjects:
            try:
                mine = product(intersection(theirs[0], self._namespace), intersection(theirs[1], self._name))
            except TooComplexError:
                if not wide:
                    continue
                mine = product((self._namespace,), (self._name,))
            for namespace, name in _singled(mine, placeholders(entry.object)):
                pattern = self._fixed(entry.object, namespace, name)
                found = fit_pattern(pattern, self._shape, namespace, name, wide=wide)
                for limits, limits2, object_ in found.pieces:
                    both = (_narrowed(namespace, limits, wide=wide), _narrowed(name, limits2, wide=wide))
                    yield from (TemplatePiece(one, other, object_) for one, other in product(*both))

    @staticmethod
    def _fixed(pattern: Glob, namespace: Glob, name: Glob) -> Glob:
        """Return a pattern with the namespace, and the name, in their places where there is only one."""
        one, other = literal(namespace), literal(name)
        return fill_placeholders(
            pattern, (NAMESPACE,) if one is None else namespace, (NAME,) if other is None else name
        )

    def _met(self, namespace: str, name: str, word: str) -> Iterator[Glob]:
        """Yield what rules that depend on the subject refuse for a namespace, or a name, where they refuse a word."""
        exact = (_text(namespace), _text(name))
        for condition in self._conditions:
            for entry in condition.none:
                used = placeholders(entry.object)
                if not used or not matches(fill_placeholders(entry.object, *exact), word):
                    continue
                for one, other in entry.subjects:
                    if not (matches(one, namespace) and matches(other, name)):
                        continue
                    narrow = SymbolicEntry(
                        ((exact[0] if NAMESPACE in used else one, exact[1] if NAME in used else other),), entry.object
                    )
                    yield from (_word(p.namespace, p.name, p.object) for p in self._pieces(narrow, wide=False))

    def _miscounted(self) -> Iterator[Glob]:
        """Yield the words that have more marks than the shape: what a star of it matches has none."""
        used = placeholders(self._shape)
        for mark in PLACEHOLDERS:
            yield normalise((STAR, *(each for _ in range(used.count(mark) + 1) for each in (mark, STAR))))

    def _subject(self, subject: str) -> Glob:
        head, _, last = subject.removeprefix("/").rpartition("/")
        return _word(_text(f"{head}/" if head else ""), _text(last), self._rest)

    @property
    def _rest(self) -> Glob:
        return (STAR, SEPARATOR, STAR) if self._kind == RAW else (STAR,)


def _text(text: str) -> Glob:
    return (text,) if text else ()


def _word(namespace: Glob, name: Glob, object_: Glob) -> Glob:
    return normalise((*namespace, SEPARATOR, *name, SEPARATOR, *object_))


def _narrowed(pattern: Glob, limits: Sequence[Glob], *, wide: bool) -> tuple[Glob, ...]:
    """Return patterns of what a pattern and some others match; too much (wide) or too little where that is too hard."""
    found: tuple[Glob, ...] = (pattern,)
    for limit in limits:
        try:
            found = tuple(dict.fromkeys(each for one in found for each in intersection(one, limit)))
        except TooComplexError:
            if not wide:
                return ()
    return found


@lru_cache(maxsize=8)
def _alphabet(kind: str) -> Charset:
    ranges = universe(kind).alphabet.ranges
    return charset((*ranges, (ord(NAMESPACE), ord(NAMESPACE)), (ord(NAME), ord(NAME))))


@lru_cache(maxsize=8)
def _illegal(kind: str) -> tuple[Glob, ...]:
    """Return patterns of the words with an illegal subject or object name.

    See :mod:`keymint.names` for subjects and :func:`keymint.analysis.rule_lists.legal_names` for objects.
    """
    rest = (STAR, SEPARATOR, STAR) if kind == RAW else (STAR,)
    digit = parse(_DIGITS)
    namespaces = (
        ("/", STAR),
        (STAR, "//", STAR),
        (*digit, STAR),
        (STAR, "/", *digit, STAR),
        (STAR, _NAMES.complement(), STAR),
        (STAR, charset(((ord("/"), ord("/")),)).complement()),
    )
    names_ = ((), (*digit, STAR), (STAR, _LETTERS.complement(), STAR))
    objects = (
        (),
        (charset(((ord("/"), ord("/")),)).complement(), STAR),
        (STAR, "/"),
        (STAR, "//", STAR),
        (STAR, "/", *digit, STAR),
        (STAR, f"{NAMESPACE}/", STAR),
        (STAR, NAMESPACE, *digit, STAR),
        (STAR, NAMESPACE),
        (STAR, _MARKED.complement(), STAR),
    )
    return (
        *(_word(each, (STAR,), rest) for each in namespaces),
        *(_word((STAR,), each, rest) for each in names_),
        *(() if kind == RAW else (_word((STAR,), (STAR,), each) for each in objects)),
    )
