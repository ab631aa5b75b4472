# SPDX-License-Identifier: Apache-2.0
"""Classes of subjects of which all members change in the same way, apart from their own namespace and name.

A class begins as the pattern in which a subject that changes was found. It is narrowed until all members have the same
rules where they matter, no member changes in another way, and no placeholder meets another pattern by coincidence.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import partial
from itertools import product

from comarmor.patterns.decision_lists import Unknown, negate
from comarmor.patterns.glob import Glob, literal, matches, normalise, parse, right_quotient
from comarmor.patterns.relations import TooComplexError, covers, disjoint, intersection, maximal
from comarmor.patterns.tokens import STAR
from comarmor.rules import PARTS, Effect, parts
from comarmor.values import Data, replace
from keymint.analysis.permission_changes import KEYS, PatternComparison, PermissionChange, Versions
from keymint.analysis.rule_lists import (
    PermissionKey,
    allow_only,
    decision_list,
    find_permitted,
    overlap,
    part_patterns,
)
from keymint.analysis.subject_patterns import SubjectClass, rules_of
from keymint.analysis.symbolic_rules import (
    EVERYBODY,
    Entries,
    SymbolicEntry,
    SymbolicRule,
    exact_halves,
    fill_placeholders,
    fit_pattern,
    placeholders,
)
from keymint.analysis.symbolic_search import find_subject

_MOST_SPLITS = 256
"""Maximum number of times that a class is narrowed."""


class _NotAlikeError(Exception):
    """A class cannot be narrowed to members that change alike; the message tells why."""


class ClassFinder(Data):
    """Finds the class of a subject that changes.

    Attributes:
        versions: both policies, and the subjects that are no members of any class here.
        comparisons: what is gained, and what is lost.
    """

    versions: Versions
    comparisons: Sequence[PatternComparison]

    def class_of(
        self, subject: str, rule: SymbolicRule, within: Glob, changes: Sequence[PermissionChange]
    ) -> tuple[SubjectClass, tuple[PermissionChange, ...], str]:
        """Return a class in which all members change as a subject does, and these changes with placeholders.

        Args:
            subject: the subject.
            rule: the rule that allows the difference that it is an example of.
            within: pattern of the subjects that change.
            changes: what it gains and loses.

        Returns:
            The class, the changes, and an empty text; or why none was found within the limits, and where.
        """
        area, reason = SubjectClass(within), "profiles overlap in too many ways"
        undecided = next((change.unknown for change in changes if change.unknown), "")
        if undecided or rule.reach.left:
            return area, (), undecided or reason
        symbolic = tuple(self._with_placeholders(subject, change) for change in changes)
        try:
            for _ in range(_MOST_SPLITS):
                # Members that differ from the subject are cut off, until all are alike.
                cuts = (_cut(area, subject, profiles) for profiles in self._decisive(area, subject, symbolic))
                narrower = next(filter(None, cuts), None) or self._by_change(area, subject, symbolic)
                narrower = narrower or self._by_claim(area, subject, symbolic)
                if narrower is None:
                    return area, symbolic, ""
                area = narrower
        except (_NotAlikeError, TooComplexError) as error:
            reason = str(error) or reason
        return area, (), reason

    def _decisive(
        self, area: SubjectClass, subject: str, changes: Sequence[PermissionChange]
    ) -> Iterator[Sequence[Sequence[str]]]:
        """Yield nested profiles that must apply to all members or to none."""
        for policy, book in zip(self.versions.policies, self.versions.books, strict=True):
            if policy.rules(subject) is None:
                yield from (profiles for one, profiles in book.profiles.meeting(area.like) if area.overlaps([one]))
            else:
                own = [profiles for _, profiles in book.profiles.matching(subject)]
                yield from own if not any(_cut(area, subject, each) is None for each in own) else ()
        for key, objects in dict.fromkeys(_concerned(changes)):
            for rule in self._rules(key, area):
                if rule.may_meet(objects, area):
                    yield rule.profiles

    def _by_change(self, area: SubjectClass, subject: str, changes: Sequence[PermissionChange]) -> SubjectClass | None:
        """Return the part without a member that changes in a way in which the subject does not."""
        for comparison, key in product(self.comparisons, KEYS):
            said = [objects for one, objects in _covered(changes, comparison.gains) if one == key]
            for allowing, _, found in comparison.differences(key, area, said, ()):
                if isinstance(found, Unknown):
                    raise _NotAlikeError(found.reason)
                near = [rule for rule in self._rules(key, area) if rule.may_meet(allowing.object, area)]
                for rule in near:
                    if (narrower := _cut(area, subject, rule.profiles)) is not None:
                        return narrower
                objects = [rule.object for rule in near]
                return _without_coincidence(area, subject, found, objects, allowing.object)
        return None

    def _by_claim(self, area: SubjectClass, subject: str, changes: Sequence[PermissionChange]) -> SubjectClass | None:
        """Return the part without a member for which a change is false because of its namespace or name."""
        budget = self.versions.budget
        excluded = (*area.excluded, *((name,) for name in self.versions.named))
        for after, allowed, key, objects in (claim for change in changes for claim in self._claims(change, subject)):
            entries = {
                effect: tuple(
                    SymbolicEntry((EVERYBODY,), rule.object)
                    for rule in self.versions.books[after].applying(key, effect, area.like)
                    if _applies(rule, subject) and rule.may_meet(objects, area)
                )
                for effect in Effect
            }
            denied, permitted = entries[Effect.DENY], entries[Effect.ALLOW]
            patterns = [each.object for both in entries.values() for each in both]
            if not any(map(placeholders, (objects, *patterns))):
                continue
            check = partial(self._refutes, after, allowed, key, objects)
            searches: Sequence[tuple[tuple[Entries, ...], Entries]]
            searches = (((denied,), ()), ((), permitted)) if allowed else (((permitted,), denied),)
            for some, none in searches:
                found = find_subject(key[0], area.like, objects, some, none, check, excluded, budget)
                if isinstance(found, Unknown):
                    raise _NotAlikeError(found.reason)
                if found is not None:
                    return _without_coincidence(area, subject, found, patterns, objects)
        return None

    def _rules(self, key: PermissionKey, area: SubjectClass) -> Iterator[SymbolicRule]:
        """Yield the rules of a permission that may apply to members, of both policies."""
        for book, effect in product(self.versions.books, Effect):
            yield from book.applying(key, effect, area.like)

    def _claims(self, change: PermissionChange, subject: str) -> Iterator[tuple[bool, bool, PermissionKey, Glob]]:
        """Yield what a change says: the one policy allows all parts, the other one denies one of them.

        Yields:
            Whether it is about the newer policy; whether that allows the objects, or denies all; permission; objects.
        """
        if not change.whole and placeholders(change.objects):
            raise _NotAlikeError("only a part of a pattern with {namespace} or {name} changes")
        pieces = [*part_patterns(change.kind, change.permission, change.objects if change.whole else (change.word,))]
        yield from ((change.gains, True, *each) for each in pieces)
        claims = [(not change.gains, False, *each) for each in pieces]
        denied = next((claim for claim in claims if self._refutes(*claim, subject) is False), None)
        if denied is None:
            raise _NotAlikeError("the parts of a permission change in several ways")
        yield denied

    def _refutes(self, after: bool, allowed: bool, key: PermissionKey, objects: Glob, subject: str) -> bool | Unknown:
        """Return whether a statement of a change is false for a subject."""
        budget = self.versions.budget
        decided = decision_list(rules_of(self.versions.policies[after], subject), key)
        concrete = allow_only(fill_placeholders(objects, *exact_halves(subject)))
        sought = negate(decided) if allowed else decided
        return budget.verdict(find_permitted(key[0], concrete, sought, budget=budget.next_query()))

    def _with_placeholders(self, subject: str, change: PermissionChange) -> PermissionChange:
        """Return a change of a subject with the placeholders of the rule behind it."""
        halves = exact_halves(subject)
        (kind, part, suffix), *_ = parts(change.kind, change.permission)
        key, near, books = (kind, part), (subject,), self.versions.books
        allowed = [rule.object for rule in books[change.gains].applying(key, Effect.ALLOW, near)]
        denied = [rule.object for rule in books[not change.gains].applying(key, Effect.DENY, near)]
        both = [piece for one in allowed for other in denied for piece in overlap(one, other)]
        written = (base for each in (*allowed, *denied, *both) for base in right_quotient(each, suffix))
        found = (each for each in written if fill_placeholders(each, *halves) == change.objects)
        return replace(change, objects=next(found, change.objects))


def _without_coincidence(
    area: SubjectClass, subject: str, other: str, objects: Iterable[Glob], shape: Glob
) -> SubjectClass:
    """Return the part without a member for which a pattern of objects with placeholders meets another one."""
    for pattern in objects:
        for one, two in ((pattern, shape), (shape, pattern)):
            for namespaces, names, _ in fit_pattern(one, two, *EVERYBODY, wide=True).pieces:
                for apart in _subjects_with(namespaces, names):
                    if matches(apart, subject) is not matches(apart, other):
                        return _split(area, subject, [apart])
    raise _NotAlikeError("{namespace} or {name} makes single subjects differ")


def _applies(rule: SymbolicRule, subject: str) -> bool:
    return all(any(matches(parse(each), subject) for each in level) for level in rule.profiles)


def _cut(area: SubjectClass, subject: str, profiles: Sequence[Sequence[str]]) -> SubjectClass | None:
    """Return the part of a class to which nested profiles apply as they do to a subject; None if that is all of it."""
    for level in reversed(profiles):
        expressions = [each for each in map(parse, level) if literal(each) is None and not disjoint(each, area.like)]
        if not any(matches(each, subject) for each in expressions):
            more = [each for each in expressions if each not in area.excluded]
            return _split(area, subject, more) if more else None
    for level in profiles:
        expressions = [each for each in map(parse, level) if matches(each, subject)]
        if not any(covers(each, area.like) for each in expressions):
            return _split(area, subject, expressions[:1])
    return None


def _split(area: SubjectClass, subject: str, apart: Sequence[Glob]) -> SubjectClass:
    """Return the part of a class that a pattern matches, if it matches the subject, or that no pattern matches."""
    if not matches(apart[0], subject):
        return replace(area, excluded=tuple(maximal((*area.excluded, *apart))))
    like = next(piece for piece in intersection(area.like, apart[0]) if matches(piece, subject))
    return SubjectClass(like, tuple(each for each in area.excluded if not disjoint(each, like)))


def _concerned(changes: Iterable[PermissionChange]) -> Iterator[tuple[PermissionKey, Glob]]:
    """Yield the permissions without parts, with objects, on which changes depend."""
    for change in changes:
        yield from part_patterns(change.kind, change.permission, change.objects)
        for whole, implementing in PARTS.items():
            for kind, part, end in implementing:
                if (kind, part) == (change.kind, change.permission):
                    for base in right_quotient(change.objects, end):
                        yield from part_patterns(*whole, base)


def _covered(changes: Sequence[PermissionChange], gains: bool) -> Iterator[tuple[PermissionKey, Glob]]:
    """Yield the permissions without parts, with objects, that changes tell of."""
    for change in changes:
        if change.gains is gains and (change.whole or (change.kind, change.permission) not in PARTS):
            yield from part_patterns(change.kind, change.permission, change.objects)


def _subjects_with(namespaces: Sequence[Glob], names: Sequence[Glob]) -> Iterator[Glob]:
    """Yield patterns of subjects that tell apart those with a namespace and a name."""
    namespace = namespaces[0] if namespaces else ()
    name = names[0] if names else (STAR,)
    yield normalise(("/", *namespace, *name))
    yield normalise(("/", *namespace, STAR, "/", *name))
