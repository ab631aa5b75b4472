# SPDX-License-Identifier: Apache-2.0
"""Find what one policy allows and another one does not: for one subject, and for all that no policy names.

:func:`rule_changes` compares two versions of a subject's rules semantically, over all possible names.

:class:`PatternComparison` searches the subjects that neither of two policies names for one that gains or loses
something. Only a rule in just one of the policies can make a difference. For each such rule one search covers all
subjects and objects at once (:mod:`keymint.analysis.symbolic_search`); rules in both policies cost nothing.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from functools import cache, partial
from itertools import product

from comarmor.patterns.decision_lists import DecisionList, Equal, ProofResult, Unknown, Witness, negate
from comarmor.patterns.glob import Glob, matches, parse, surround
from comarmor.patterns.relations import covers, disjoint
from comarmor.rules import PARTS, PERMISSIONS, Effect, parts
from comarmor.values import Data
from keymint.analysis.rule_lists import (
    ListComparison,
    PermissionKey,
    allow_only,
    decision_list,
    deny_over_allow,
    display_name,
    display_pattern,
    find_permitted,
    object_patterns,
    overlap,
    part_patterns,
    restrict_allowed,
    strip_suffix,
)
from keymint.analysis.subject_patterns import SubjectClass, rules_of
from keymint.analysis.symbolic_rules import (
    EVERYBODY,
    Entries,
    SymbolicEntry,
    SymbolicRule,
    SymbolicRules,
    as_written,
    exact_halves,
    fill_placeholders,
    fit_pattern,
    placeholders,
)
from keymint.analysis.symbolic_search import QueryBudget, find_subject
from keymint.api import LoadedPolicy
from keymint.errors import Origin
from keymint.ir import Rule


class PermissionChange(Data):
    """Objects on which a subject gains, or loses, a permission.

    Attributes:
        gains: True if only the newer policy allows it, False if only the older one does.
        kind: kind of the objects.
        permission: the permission.
        objects: pattern of the words of the objects.
        whole: everything that the pattern matches changes, not only a part.
        word: the shortest name that changes, with the partition for kind ``topic``; empty if unknown.
        where: the rule that allows it; None if unknown.
        unknown: why the answer is unknown, or empty.
        build_type: of several build types, the only one whose documents change so; else empty.
    """

    gains: bool
    kind: str
    permission: str
    objects: Glob
    whole: bool
    word: str
    where: Origin | None
    unknown: str = ""
    build_type: str = ""

    @property
    def pattern(self) -> str:
        """Expression of the objects, with the partition if it is not the default one."""
        return as_written(display_pattern(self.kind, self.objects))

    @property
    def example(self) -> str:
        """The shortest name that changes, as display text."""
        return display_name(self.kind, self.word)


def rule_changes(old: Sequence[Rule], new: Sequence[Rule], budget: QueryBudget) -> Iterator[PermissionChange]:
    """Yield what a subject gains and loses when its rules change, gains first.

    Args:
        old: its older rules.
        new: its newer rules.
        budget: limit of the search.
    """
    yield from _RuleComparison(True, old, new, budget).changes()
    yield from _RuleComparison(False, new, old, budget).changes()


class _RuleComparison:
    """Finds what some rules allow and others do not.

    A pattern that both have is searched only if a denial was lifted from it, among the patterns that may meet it.

    Args:
        gains: the rules that allow it are the newer ones.
        before: the rules that do not allow it.
        after: the rules that do.
        budget: limit of the search.
    """

    def __init__(self, gains: bool, before: Sequence[Rule], after: Sequence[Rule], budget: QueryBudget) -> None:
        self._gains = gains
        self._after = after
        self._budget = budget
        # Compares the lists of a permission without parts.
        self._lists = cache(lambda key: ListComparison(*(decision_list(rules, key) for rules in (before, after))))

    def changes(self) -> Iterator[PermissionChange]:
        """Yield the changes, permissions without parts first; composite permissions cover those of their parts."""
        composite = [change for key in PARTS for change in self._composite(key)]
        explained: dict[PermissionKey, list[Glob]] = {}
        for change in composite:
            pieces = [*part_patterns(change.kind, change.permission, change.objects)]
            if all(self._is_whole(key[0], piece, *self._lists(key).near(piece)) for key, piece in pieces):
                for key, piece in pieces:
                    explained.setdefault(key, []).append(piece)
        for key in KEYS:
            for change in self._elementary(key):
                if not any(covers(outer, change.objects) for outer in explained.get(key, ())):
                    yield change
        yield from composite

    def _find(self, kind: str, *lists: DecisionList) -> ProofResult:
        return find_permitted(kind, *lists, budget=self._budget.next_query())

    def _change(
        self, key: PermissionKey, objects: Glob, outcome: Witness | Unknown, whole: bool, where: Origin
    ) -> PermissionChange:
        if isinstance(outcome, Unknown):
            return PermissionChange(self._gains, *key, objects, False, "", where, outcome.reason)
        return PermissionChange(self._gains, *key, objects, whole, outcome.word, where)

    def _elementary(self, key: PermissionKey) -> list[PermissionChange]:
        """Return the changes for a kind and permission without parts.

        Of each pattern that a rule allows now, these are what was denied, and what no rule allowed.
        """
        kind = key[0]
        changes: list[PermissionChange] = []
        for rule in self._after:
            for pattern in object_patterns(rule, key) if rule.effect is Effect.ALLOW else ():
                if not self._lists(key).may_gain(pattern):
                    continue
                old, new = self._lists(key).near(pattern)
                denied = tuple(each for each in old[0].patterns if not disjoint(pattern, each))
                unmatched: DecisionList = (*(block for block in old if not block.allows), *negate(old)[1:])
                allowed_now = restrict_allowed(pattern, new)
                outcome = self._find(kind, allowed_now, unmatched)
                if not isinstance(outcome, Equal):
                    whole = not denied and self._is_whole(kind, pattern, old, new)
                    changes.append(self._change(key, pattern, outcome, whole, rule.origin))
                for denial in denied:
                    for piece in overlap(pattern, denial):
                        outcome = self._find(kind, allow_only(piece), allow_only(denial), allowed_now)
                        if not isinstance(outcome, Equal):
                            whole = self._is_whole(kind, piece, old, new)
                            changes.append(self._change(key, piece, outcome, whole, rule.origin))
        return _maximal(changes)

    def _composite(self, key: PermissionKey) -> list[PermissionChange]:
        """Return the changes for a permission with parts: all parts are allowed now, and were not."""
        kind, permission = key
        candidates = {
            parse(expression): rule.origin
            for rule in reversed(self._after)
            if rule.effect is Effect.ALLOW and rule.kind == kind and permission in rule.permissions
            for expression in rule.expressions
        }
        if not candidates:
            return []
        changes: list[PermissionChange] = []
        for pattern, where in candidates.items():
            pieces = [
                (self._lists((part_kind, part)), surround("", pattern, suffix), suffix)
                for part_kind, part, suffix in parts(kind, permission)
            ]
            if not any(lists.may_gain(piece) for lists, piece, _ in pieces):
                continue
            decided = ([strip_suffix(each, suffix) for each in lists.near(piece)] for lists, piece, suffix in pieces)
            old, new = zip(*decided, strict=True)
            outcomes = [self._find(kind, allow_only(pattern), *new, negate(part)) for part in old]
            witnesses = (each for each in outcomes if isinstance(each, Witness))
            undecided = next((each for each in outcomes if isinstance(each, Unknown)), None)
            outcome = min(witnesses, key=lambda each: (len(each.word), each.word), default=undecided)
            if outcome is not None:
                had = not isinstance(self._find(kind, allow_only(pattern), *old), Equal)
                lacks = any(not isinstance(self._find(kind, allow_only(pattern), negate(part)), Equal) for part in new)
                changes.append(self._change(key, pattern, outcome, not had and not lacks, where))
        return _maximal(changes)

    def _is_whole(self, kind: str, pattern: Glob, old: DecisionList, new: DecisionList) -> bool:
        """Return True if the older list denies, and the newer one allows, everything that a pattern matches."""
        allowed_before = self._find(kind, allow_only(pattern), old)
        denied_now = self._find(kind, allow_only(pattern), negate(new))
        return isinstance(allowed_before, Equal) and isinstance(denied_now, Equal)


def _maximal(changes: Sequence[PermissionChange]) -> list[PermissionChange]:
    """Return the changes whose pattern is not covered by another one."""
    kept: list[PermissionChange] = []
    for at, change in enumerate(changes):
        others = (*kept, *changes[at + 1 :])
        if not any(covers(other.objects, change.objects) and (other.whole or not change.whole) for other in others):
            kept.append(change)
    return kept


KEYS: tuple[PermissionKey, ...] = tuple(
    key for kind, permissions in PERMISSIONS.items() for key in product((kind,), permissions) if key not in PARTS
)
"""The permissions without parts: policies that agree on these agree on all."""
_ROUNDS = 16
"""Maximum number of examples for a rule and a pattern of its subjects."""


PatternDifference = tuple[SymbolicRule, Glob, str | Unknown]
"""A difference for subjects that no policy names.

It is the rule that allows it, the pattern of the subjects that were searched, and an example, or why it is not known
whether there is one.
"""


class Versions(Data):
    """Two policies to compare.

    Attributes:
        policies: the older one and the newer one.
        books: the rules of both.
        named: subjects that are compared by themselves, and ignored among those that patterns match.
        budget: limit of the search.
    """

    policies: tuple[LoadedPolicy, LoadedPolicy]
    books: tuple[SymbolicRules, SymbolicRules]
    named: Collection[str]
    budget: QueryBudget


class PatternComparison:
    """Finds what one policy allows and another one does not.

    Args:
        gains: the policy that allows it is the newer one; also an attribute.
        versions: both policies.
    """

    def __init__(self, gains: bool, versions: Versions) -> None:
        self.gains = gains
        self._policies = versions.policies if gains else versions.policies[::-1]
        self._before, self._after = versions.books if gains else versions.books[::-1]
        self._budget = versions.budget
        # Returns the named subjects that match a pattern.
        self._matching_named = cache(lambda like: tuple((name,) for name in versions.named if matches(like, name)))
        self._changed = cache(self._changed_rules)

    def differences(
        self, key: PermissionKey, area: SubjectClass, said: Sequence[Glob], listed: Sequence[SubjectClass]
    ) -> Iterator[PatternDifference]:
        """Yield differences for a kind and permission; no result proves that there is none.

        Args:
            key: the permission.
            area: the subjects to search.
            said: patterns of symbolic words to ignore.
            listed: classes of subjects to ignore; may grow between results.
        """
        if not any(self._changed(key)):
            return
        for rule in self._after.applying(key, Effect.ALLOW, area.like):
            for subjects in dict.fromkeys(each for one in rule.reach.subjects for each in overlap(area.like, one)):
                searches = list(self._searches(key, rule, subjects))
                for left in reversed(range(_ROUNDS + 1) if searches else ()):
                    part = SubjectClass(subjects, area.excluded)
                    answer = self._first(key, rule, part, searches, said, listed)
                    if answer is None:
                        break
                    if not left:
                        answer = Unknown(f"its subjects change in more than {_ROUNDS} ways")
                    yield rule, subjects, answer
                    if isinstance(answer, Unknown):
                        break

    def _changed_rules(self, key: PermissionKey) -> tuple[set[object], tuple[SymbolicRule, ...]]:
        """Return the contents of the new rules that allow something, and the old rules that denied something."""
        new = self._after.all(key, Effect.ALLOW).keys() - self._before.all(key, Effect.ALLOW).keys()
        denials = self._before.all(key, Effect.DENY)
        lifted = [denials[content] for content in denials.keys() - self._after.all(key, Effect.DENY).keys()]
        return {*new}, tuple(sorted(lifted, key=lambda one: (one.where, str(one.content))))

    def _first(
        self,
        key: PermissionKey,
        rule: SymbolicRule,
        area: SubjectClass,
        searches: Sequence[_Alternatives],
        said: Sequence[Glob],
        listed: Sequence[SubjectClass],
    ) -> str | Unknown | None:
        """Return the first subject found by a search, else the reason why one of them is undecided."""
        check = cache(partial(self._differs, key, rule.object, said))
        excluded = (*area.excluded, *self._matching_named(area.like))
        listed = [each for each in listed if not disjoint(each.like, area.like)]
        more = tuple(SymbolicEntry((EVERYBODY,), each) for each in said)
        undecided: Unknown | None = None
        for alternatives in searches:
            answer: str | Unknown | None = None
            for shape, some, none in alternatives:
                ignored = (*none, *more)
                answer = find_subject(key[0], area.like, shape, some, ignored, check, excluded, self._budget, listed)
                if not isinstance(answer, Unknown):
                    break
            if isinstance(answer, str):
                return answer
            undecided = undecided or answer
        return undecided

    def _searches(self, key: PermissionKey, rule: SymbolicRule, subjects: Glob) -> Iterator[_Alternatives]:
        """Yield searches for what a rule allows and no rule allowed before, or a lifted rule denied before."""
        new, lifted = self._changed(key)
        overlapping = [denial for denial in lifted if denial.may_meet(rule.object, SubjectClass(subjects))]
        if rule.content not in new and not overlapping:
            return
        denied = self._after.surely(key, Effect.DENY, subjects)
        if rule.content in new:
            allowed = self._before.surely(key, Effect.ALLOW, subjects)
            yield [(rule.object, rule.reach.conditions, (*denied, *allowed))]
        entries = tuple(denial.entry() for denial in overlapping if not placeholders(denial.object))
        if entries:
            yield [(rule.object, (*rule.reach.conditions, entries), denied)]
        for denial in overlapping:
            if placeholders(denial.object):
                both = (*rule.reach.conditions, *denial.reach.conditions, (denial.entry(),))
                alternatives = [(denial.object, (*both, (rule.entry(),)), denied)]
                if placeholders(rule.object):
                    alternatives.append((rule.object, both, denied))
                yield sorted(alternatives, key=_inexact_entries)

    def _differs(self, key: PermissionKey, pattern: Glob, said: Sequence[Glob], subject: str) -> bool | Unknown:
        """Return True if only one policy allows a subject something that a pattern matches, besides what is ignored."""
        concrete, *ignored = (fill_placeholders(each, *exact_halves(subject)) for each in (pattern, *said))
        before, after = (decision_list(rules_of(policy, subject), key) for policy in self._policies)
        budget = self._budget.next_query()
        shown = deny_over_allow(ignored, [concrete])
        return self._budget.verdict(find_permitted(key[0], shown, after, negate(before), budget=budget))


_Search = tuple[Glob, tuple[Entries, ...], Entries]
"""Arguments of :func:`~keymint.analysis.symbolic_search.find_subject`: shape of the words, and their entries."""
_Alternatives = Sequence[_Search]
"""Searches with the same answer: any of them proves that there is no subject."""


def _inexact_entries(search: _Search) -> int:
    """Return the number of entries that cannot be rewritten exactly to the placeholders of the shape."""
    shape, some, none = search
    entries = (entry for each in (*some, none) for entry in each)
    return sum(not fit_pattern(entry.object, shape, *EVERYBODY, wide=False).exact for entry in entries)
