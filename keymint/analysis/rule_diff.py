"""Compare two versions of a subject's rules semantically: gained and lost permissions, over all possible names."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from comarmor.errors import Origin
from comarmor.patterns.decision_lists import DecisionList, Equal, ProofResult, Unknown, Witness
from comarmor.patterns.glob import Glob, parse, surround
from comarmor.patterns.proofs import difference
from comarmor.patterns.relations import TooComplexError, covers, disjoint, intersection
from comarmor.rules import PERMISSIONS, Effect, parts
from keymint.analysis.query_budget import QueryBudget
from keymint.analysis.rule_lists import (
    PermissionKey,
    allow_only,
    decision_list,
    display_name,
    display_pattern,
    find_permitted,
    is_composite,
    negated,
    part_lists,
    permission_keys,
    rule_patterns,
    universe,
)
from keymint.analysis.subject_patterns import restrict_allowed
from keymint.ir import Rule


@dataclass(frozen=True, slots=True)
class PermissionChange:
    """Objects on which a subject gains, or loses, a permission.

    Attributes:
        gains: True if only the newer policy allows it, False if only the older one does.
        kind: kind of the objects.
        permission: the permission.
        pattern: expression of the objects, with the partition if it is not the default one.
        whole: everything that the pattern matches changes, not only a part.
        word: the shortest name that changes, with the partition for kind ``topic``; empty if unknown.
        where: the rule that allows it; None if unknown.
        unknown: why the answer is unknown, or empty.
    """

    gains: bool
    kind: str
    permission: str
    pattern: str
    whole: bool
    word: str
    where: Origin | None
    unknown: str = ""

    @property
    def example(self) -> str:
        """The shortest name that changes, as display text."""
        return display_name(self.kind, self.word)


def rule_changes(
    old: Sequence[Rule], new: Sequence[Rule], budget: QueryBudget | None = None
) -> Iterator[PermissionChange]:
    """Yield what a subject gains and loses when its rules change, gains first.

    Args:
        old: its older rules.
        new: its newer rules.
        budget: limit of the search.
    """
    budget = budget or QueryBudget()
    for is_gain, before, after in ((True, old, new), (False, new, old)):
        for kind, permission, pattern, example, whole, where, unknown in _RuleComparison(
            before, after, budget
        ).differences():
            yield PermissionChange(
                is_gain, kind, permission, display_pattern(kind, pattern), whole, example, where, unknown
            )


_Difference = tuple[str, str, Glob, str, bool, Origin, str]
"""Kind, permission, pattern, example, whether all of the pattern changes, the rule that allows it, and why unknown."""


class _RuleComparison:
    """Finds what some rules allow and others do not.

    Args:
        before: the rules that do not allow it.
        after: the rules that do.
        budget: limit of the search.
    """

    def __init__(self, before: Sequence[Rule], after: Sequence[Rule], budget: QueryBudget) -> None:
        self._before = before
        self._after = after
        self._budget = budget

    def differences(self) -> Iterator[_Difference]:
        """Yield the differences, permissions without parts first; composite permissions cover those of their parts."""
        all_ = [(kind, permission) for kind, permissions in PERMISSIONS.items() for permission in permissions]
        composite = [each for key in all_ if is_composite(*key) for each in self._composite(*key)]
        explained: dict[PermissionKey, list[Glob]] = {}
        for kind, permission, pattern, *_ in composite:
            pieces = [((of, part), surround("", pattern, suffix)) for of, part, suffix in parts(kind, permission)]
            if all(self._is_changed(key, piece) for key, piece in pieces):
                for key, piece in pieces:
                    explained.setdefault(key, []).append(piece)
        for key in all_:
            if not is_composite(*key):
                for each in self._elementary(key):
                    if not any(covers(outer, each[2]) for outer in explained.get(key, ())):
                        yield each
        yield from composite

    def _is_changed(self, key: PermissionKey, piece: Glob) -> bool:
        return self._is_whole(key[0], piece, decision_list(self._before, key), decision_list(self._after, key))

    def _find(self, kind: str, *lists: DecisionList) -> ProofResult:
        return find_permitted(kind, *lists, budget=self._budget.next_query())

    def _elementary(self, key: PermissionKey) -> list[_Difference]:
        """Return the differences for a kind and permission without parts."""
        old, new = decision_list(self._before, key), decision_list(self._after, key)
        if isinstance(difference(old, new, universe=universe(key[0]), budget=self._budget.next_query()), Equal):
            return []
        denied = tuple(dict.fromkeys(pattern for block in old if not block.allows for pattern in block.patterns))
        differences: list[_Difference] = []
        for rule in self._after:
            if rule.effect is not Effect.ALLOW or key not in permission_keys(rule):
                continue
            for expression in rule.expressions:
                for pattern in rule_patterns(rule, expression, key):
                    differences += self._of_pattern(pattern, old, new, denied, key, rule.origin)
        return _maximal(differences)

    def _of_pattern(
        self,
        pattern: Glob,
        old: DecisionList,
        new: DecisionList,
        denied: tuple[Glob, ...],
        key: PermissionKey,
        where: Origin,
    ) -> Iterator[_Difference]:
        """Yield the newly allowed part of a pattern: what was denied, and what no rule allowed."""
        kind, permission = key
        allowed_now = restrict_allowed(pattern, new)
        unmatched: DecisionList = (*(block for block in old if not block.allows), *negated(old)[1:])
        outcome = self._find(kind, allowed_now, unmatched)
        if not isinstance(outcome, Equal):
            whole = not any(not disjoint(pattern, each) for each in denied) and self._is_whole(kind, pattern, old, new)
            yield _difference(key, pattern, outcome, whole, where)
        for each in denied:
            try:
                pieces = intersection(pattern, each)
            except TooComplexError:
                pieces = (pattern,)
            for piece in pieces:
                outcome = self._find(kind, allow_only(piece), allow_only(each), allowed_now)
                if not isinstance(outcome, Equal):
                    yield _difference((kind, permission), piece, outcome, self._is_whole(kind, piece, old, new), where)

    def _composite(self, kind: str, permission: str) -> list[_Difference]:
        """Return the differences for a permission with parts: all parts are allowed now, and were not."""
        candidates = {
            pattern: rule.origin
            for rule in reversed(self._after)
            if rule.effect is Effect.ALLOW and rule.kind == kind and permission in rule.permissions
            for expression in rule.expressions
            for pattern in (parse(expression),)
        }
        if not candidates:
            return []
        old, new = part_lists(self._before, kind, permission), part_lists(self._after, kind, permission)
        differences: list[_Difference] = []
        for pattern, where in candidates.items():
            outcomes = [self._find(kind, allow_only(pattern), *new, negated(part)) for part in old]
            outcome = _shortest(outcomes)
            if outcome is not None:
                had = not isinstance(self._find(kind, allow_only(pattern), *old), Equal)
                lacks = any(not isinstance(self._find(kind, allow_only(pattern), negated(part)), Equal) for part in new)
                differences.append(_difference((kind, permission), pattern, outcome, not had and not lacks, where))
        return _maximal(differences)

    def _is_whole(self, kind: str, pattern: Glob, old: DecisionList, new: DecisionList) -> bool:
        """Return True if the older list denies, and the newer one allows, everything that a pattern matches."""
        allowed_before = self._find(kind, allow_only(pattern), old)
        denied_now = self._find(kind, allow_only(pattern), negated(new))
        return isinstance(allowed_before, Equal) and isinstance(denied_now, Equal)


def _shortest(outcomes: Sequence[Equal | Witness | Unknown]) -> Witness | Unknown | None:
    witnesses = [each for each in outcomes if isinstance(each, Witness)]
    if witnesses:
        return min(witnesses, key=lambda each: (len(each.word), each.word))
    return next((each for each in outcomes if isinstance(each, Unknown)), None)


def _difference(
    key: PermissionKey, pattern: Glob, outcome: Witness | Unknown, whole: bool, where: Origin
) -> _Difference:
    if isinstance(outcome, Unknown):
        return (*key, pattern, "", False, where, outcome.reason)
    return (*key, pattern, outcome.word, whole, where, "")


def _maximal(differences: Sequence[_Difference]) -> list[_Difference]:
    """Return the differences whose pattern is not covered by another one."""
    kept: list[_Difference] = []
    for at, one in enumerate(differences):
        others = (*kept, *differences[at + 1 :])
        if not any(covers(other[2], one[2]) and (other[4] or not one[4]) for other in others):
            kept.append(one)
    return kept
