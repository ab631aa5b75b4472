# SPDX-License-Identifier: Apache-2.0
r"""Search all subjects at once that a policy does not name, by patterns.

A word is ``namespace NUL name NUL object``; the object is symbolic (:mod:`keymint.analysis.symbolic_rules`). Rules
are patterns of such words: nested profiles are products, never lists of subjects. "No such subject" is proven. A
candidate is checked by its own rules in the policy. Sound, but incomplete: the answer may be unknown if patterns that
depend on the subject overlap by coincidence. All queries of a command share a budget of search states.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import lru_cache
from itertools import count, product

from comarmor.patterns.decision_lists import (
    Block,
    DecisionList,
    Equal,
    ProofResult,
    SearchBudget,
    Universe,
    Unknown,
    Witness,
    negate,
)
from comarmor.patterns.glob import Glob, literal, matches, normalise, parse, words
from comarmor.patterns.proofs import difference
from comarmor.patterns.relations import TooComplexError, intersection
from comarmor.patterns.tokens import STAR, charset
from comarmor.values import Data, field
from keymint.analysis.rule_lists import RAW, SEPARATOR, universe
from keymint.analysis.subject_patterns import SubjectClass, example_subject
from keymint.analysis.symbolic_rules import (
    NAME,
    NAMESPACE,
    PLACEHOLDERS,
    Entries,
    SymbolicEntry,
    concrete_name,
    fill_placeholders,
    fit_pattern,
    namespace_name_pairs,
    placeholders,
)

STATES = 5_000_000
"""Maximum number of states for all queries of a command."""
QUERY = 50_000
"""Maximum number of states for one query."""
_STARTS = 4
"""Calls of a query before an engine can have visited 256 states."""
_FEW = 16
"""States counted for each of these calls."""
_TICK = 256
"""States that an engine visits between two calls of :attr:`comarmor.patterns.decision_lists.SearchBudget.go_on`."""
_MOST_WORDS = 16
"""Maximum number of words of a pattern that is replaced by its words."""
_ROUNDS = 16
"""Maximum number of checked candidates; then the answer is unknown."""
_ILLEGAL_NAMESPACES = ("/*", "*//*", "[0-9]*", "*/[0-9]*", "*[!A-Za-z0-9_/]*", "*[!/]")
_ILLEGAL_NAMES = ("", "[0-9]*", "*[!A-Za-z0-9_]*")
_ILLEGAL_OBJECTS = (
    *("", "[!/]*", "*/", "*//*", "*/[0-9]*"),
    *(f"*{NAMESPACE}{rest}" for rest in ("/*", "[0-9]*", "")),
    f"*[!A-Za-z0-9_/{NAMESPACE}{NAME}]*",
)


class QueryBudget(Data, frozen=False):
    """A budget shared by several queries.

    Attributes:
        states: maximum number of states; each engine of each query counts for at least 16.
        spent: number of visited states.
    """

    states: int = STATES
    spent: int = field(default=0, init=False)

    def next_query(self, lists: int = 1) -> SearchBudget:
        """Return the budget of the next query; a state counts once for each decision list."""
        calls = count(1)

        def go_on() -> bool:
            return self.spend(lists * (_FEW if next(calls) <= _STARTS else _TICK))

        return SearchBudget(max(1, min(QUERY // lists, self.states - self.spent)), go_on)

    def spend(self, states: int) -> bool:
        """Count states; return True if any are left."""
        self.spent += states
        return not self.is_empty

    @property
    def is_empty(self) -> bool:
        """Whether nothing is left."""
        return self.spent >= self.states

    def verdict(self, outcome: ProofResult) -> bool | Unknown:
        """Return whether a query found a word, or why it was not decided."""
        if isinstance(outcome, Unknown):
            return Unknown(self.reason(outcome.reason))
        return isinstance(outcome, Witness)

    def reason(self, own: str) -> str:
        """Return why a query was not decided: the shared budget is spent, or the reason of the query itself.

        An undecided query counts in full: it may have ended at its limit of steps, and a state takes many steps.
        """
        self.spend(QUERY)
        return f"the budget of {self.states:,} states is spent" if self.is_empty else own


SubjectCheck = Callable[[str], bool | Unknown]
"""Decides exactly, by a subject's own rules, whether it fulfils the conditions."""


def find_subject(
    kind: str,
    subjects: Glob,
    shape: Glob,
    some: Sequence[Entries],
    none: Entries,
    check: SubjectCheck,
    excluded: Iterable[Glob],
    budget: QueryBudget,
    listed: Sequence[SubjectClass] = (),
) -> str | Unknown | None:
    """Find a subject with a word that matches some entries and none of others; None if there is provably none.

    An example of the pattern is tried first.

    Args:
        kind: kind of the objects.
        subjects: pattern of the subjects.
        shape: pattern of the symbolic words.
        some: the word matches at least one entry of each of these.
        none: the word matches none of these entries.
        check: decides on each candidate.
        excluded: patterns of subjects to ignore.
        budget: limit of the search.
        listed: classes of subjects to ignore.
    """
    excluded = tuple(excluded)
    example = example_subject(subjects)
    if example is not None and example in SubjectClass(subjects, excluded):
        if not any(example in each for each in listed) and check(example) is True:
            return example
        excluded = (*excluded, (example,))
    undecided: Unknown | None = None
    for namespace, name in _singled(namespace_name_pairs(subjects), placeholders(shape)):
        own = _fixed(shape, namespace, name)
        answer = _Search(kind, namespace, name, own, some, none, budget).run(check, excluded, listed)
        if isinstance(answer, str):
            return answer
        undecided = undecided or answer
    return undecided


def _singled(subjects: Iterable[tuple[Glob, Glob]], used: Sequence[str]) -> Iterator[tuple[Glob, Glob]]:
    """Yield pairs in which a used half that matches few words is replaced by each of these words."""
    for namespace, name in subjects:
        namespaces = words(namespace, _MOST_WORDS) if NAMESPACE in used else ()
        names = words(name, _MOST_WORDS) if NAME in used else ()
        yield from product([*map(_text, namespaces)] or [namespace], [*map(_text, names)] or [name])


class _Search(Data):
    """The search among subjects whose namespace and name match two patterns; see :func:`find_subject`."""

    kind: str
    namespace: Glob
    name: Glob
    shape: Glob
    some: Sequence[Entries]
    none: Entries
    budget: QueryBudget

    def run(
        self, check: SubjectCheck, excluded: Iterable[Glob], listed: Sequence[SubjectClass]
    ) -> str | Unknown | None:
        """Search, check the candidate, and search again without it; see :func:`find_subject`."""
        try:
            positives, negatives = self._lists()
        except TooComplexError:
            return Unknown("its patterns overlap in too many ways")
        refused = [*negatives, *self._words((*excluded, *(each.like for each in listed if not each.excluded)))]
        unlisted = [self._outside(each) for each in listed if each.excluded]
        placeholder_codes = ((ord(each), ord(each)) for each in PLACEHOLDERS)
        alphabet = charset((*universe(self.kind).alphabet.ranges, *placeholder_codes))
        words = Universe(alphabet, 4 if self.kind == RAW else 3, SEPARATOR, last_nonempty=self.kind == RAW)
        for _ in range(_ROUNDS):
            denied = Block(False, tuple(dict.fromkeys(refused)))
            lists: list[DecisionList] = [
                (denied, Block(True, positives[0])),
                *((Block(True, each),) for each in positives[1:]),
                *unlisted,
            ]
            if self.budget.is_empty:
                return Unknown(self.budget.reason(""))
            outcome = difference((), *lists, universe=words, budget=self.budget.next_query(len(lists)))
            if isinstance(outcome, Equal):
                return None
            if isinstance(outcome, Unknown):
                return Unknown(self.budget.reason(outcome.reason))
            namespace, name, word = outcome.word.split(SEPARATOR, 2)
            subject = f"/{namespace}{name}"
            verdict = check(subject)
            if verdict is not False:
                return subject if verdict is True else verdict
            refused += [
                *self._words([(subject,)]),
                *self._denied_for(namespace, name, concrete_name(word, namespace, name)),
            ]
        return Unknown("rules that depend on {namespace} or {name} overlap others, and no example was found")

    def _lists(self) -> tuple[list[tuple[Glob, ...]], list[Glob]]:
        """Return patterns of allowed words, of which a word matches one of each tuple, and of forbidden words."""
        positives: list[tuple[Glob, ...]] = [(_word(self.namespace, self.name, self.shape),)]
        for entries in self.some:
            found = (word for entry in entries for word in self._entry_words(entry, wide=True))
            positives.append(tuple(dict.fromkeys(found)))
        negatives = [*_illegal(self.kind)]
        # No word has more placeholders than the shape: its stars match none.
        used = placeholders(self.shape)
        negatives += (normalise((STAR, *((each, STAR) * (used.count(each) + 1)))) for each in PLACEHOLDERS)
        negatives += (word for entry in self.none for word in self._entry_words(entry, wide=False))
        return positives, negatives

    def _entry_words(self, entry: SymbolicEntry, *, wide: bool) -> Iterator[Glob]:
        """Yield an entry as patterns of words, over-approximated (wide) or under-approximated."""
        for entry_namespace, entry_name in entry.subjects:
            try:
                pairs = product(intersection(entry_namespace, self.namespace), intersection(entry_name, self.name))
            except TooComplexError:
                if not wide:
                    continue
                pairs = product((self.namespace,), (self.name,))
            for namespace, name in _singled(pairs, placeholders(entry.object)):
                pattern = _fixed(entry.object, namespace, name)
                fit = fit_pattern(pattern, self.shape, namespace, name, wide=wide)
                for limits, limits2, object_ in fit.pieces:
                    both = (_narrowed(namespace, limits, wide=wide), _narrowed(name, limits2, wide=wide))
                    yield from (_word(one, other, object_) for one, other in product(*both))

    def _denied_for(self, namespace: str, name: str, word: str) -> Iterator[Glob]:
        """Yield the words that rules with placeholders deny for a namespace and name, if they deny a given word."""
        exact = (_text(namespace), _text(name))
        for entry in self.none:
            used = placeholders(entry.object)
            if not used or not matches(fill_placeholders(entry.object, *exact), word):
                continue
            for one, other in entry.subjects:
                if not (matches(one, namespace) and matches(other, name)):
                    continue
                narrow = SymbolicEntry(
                    ((exact[0] if NAMESPACE in used else one, exact[1] if NAME in used else other),), entry.object
                )
                yield from self._entry_words(narrow, wide=False)

    def _words(self, subjects: Iterable[Glob]) -> Iterator[Glob]:
        """Yield patterns of all words of the subjects that patterns match."""
        for pattern in subjects:
            for namespace, name in namespace_name_pairs(pattern):
                yield _word(namespace, name, _any_object(self.kind))

    def _outside(self, listed: SubjectClass) -> DecisionList:
        """Return the list of the words of the subjects outside of a class."""
        excluded, inside = tuple(self._words(listed.excluded)), tuple(self._words([listed.like]))
        return negate((Block(False, excluded), Block(True, inside)))


def _fixed(pattern: Glob, namespace: Glob, name: Glob) -> Glob:
    """Return a pattern with the placeholders of an exact namespace or name filled."""
    one, other = literal(namespace), literal(name)
    return fill_placeholders(pattern, (NAMESPACE,) if one is None else namespace, (NAME,) if other is None else name)


def _text(text: str) -> Glob:
    return (text,) if text else ()


def _word(namespace: Glob, name: Glob, object_: Glob) -> Glob:
    return normalise((*namespace, SEPARATOR, *name, SEPARATOR, *object_))


def _any_object(kind: str) -> Glob:
    return (STAR, SEPARATOR, STAR) if kind == RAW else (STAR,)


def _narrowed(pattern: Glob, limits: Sequence[Glob], *, wide: bool) -> tuple[Glob, ...]:
    """Return the intersections of a pattern with limits; over- (wide) or under-approximated where too complex."""
    pieces: tuple[Glob, ...] = (pattern,)
    for limit in limits:
        try:
            pieces = tuple(dict.fromkeys(each for one in pieces for each in intersection(one, limit)))
        except TooComplexError:
            if not wide:
                return ()
    return pieces


@lru_cache(maxsize=8)
def _illegal(kind: str) -> tuple[Glob, ...]:
    """Return patterns of the words with an illegal subject or object name.

    See :mod:`keymint.names` for subjects and :func:`keymint.analysis.rule_lists.legal_names` for objects.
    """
    rest = _any_object(kind)
    return (
        *(_word(parse(each), (STAR,), rest) for each in _ILLEGAL_NAMESPACES),
        *(_word((STAR,), parse(each), rest) for each in _ILLEGAL_NAMES),
        *(() if kind == RAW else (_word((STAR,), (STAR,), parse(each)) for each in _ILLEGAL_OBJECTS)),
    )
