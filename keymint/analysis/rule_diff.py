# SPDX-License-Identifier: Apache-2.0
"""Compare two versions of a subject's rules semantically: gained and lost permissions, over all possible names."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from comarmor.errors import Origin
from comarmor.patterns.decision_lists import DecisionList, Equal, ProofResult, Unknown, Witness, negate
from comarmor.patterns.glob import Glob, parse
from comarmor.patterns.proofs import difference
from comarmor.patterns.relations import covers, disjoint
from comarmor.patterns.tokens import STAR
from comarmor.rules import PARTS, PERMISSIONS, Effect
from comarmor.values import dataclass
from keymint.analysis.query_budget import QueryBudget
from keymint.analysis.rule_lists import (
    PermissionKey,
    allow_only,
    decision_list,
    display_name,
    display_pattern,
    find_permitted,
    object_patterns,
    overlap,
    part_lists,
    part_patterns,
    restrict_allowed,
    universe,
)
from keymint.analysis.subject_templates import as_written
from keymint.ir import Rule


@dataclass(frozen=True, slots=True)
class PermissionChange:
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
    """

    gains: bool
    kind: str
    permission: str
    objects: Glob
    whole: bool
    word: str
    where: Origin | None
    unknown: str = ""

    @property
    def pattern(self) -> str:
        """Expression of the objects, with the partition if it is not the default one."""
        return as_written(display_pattern(self.kind, self.objects))

    @property
    def example(self) -> str:
        """The shortest name that changes, as display text."""
        return display_name(self.kind, self.word)


def unknown_change(reason: str) -> PermissionChange:
    """Return an unknown change of any permission."""
    return PermissionChange(True, "", "", (STAR,), False, "", None, reason)


def rule_changes(old: Sequence[Rule], new: Sequence[Rule], budget: QueryBudget) -> Iterator[PermissionChange]:
    """Yield what a subject gains and loses when its rules change, gains first.

    Args:
        old: its older rules.
        new: its newer rules.
        budget: limit of the search.
    """
    yield from _RuleComparison(True, old, new, budget).changes()
    yield from _RuleComparison(False, new, old, budget).changes()


@dataclass(frozen=True, slots=True)
class _RuleComparison:
    """Finds what some rules allow and others do not.

    Attributes:
        gains: the rules that allow it are the newer ones.
        before: the rules that do not allow it.
        after: the rules that do.
        budget: limit of the search.
    """

    gains: bool
    before: Sequence[Rule]
    after: Sequence[Rule]
    budget: QueryBudget

    def changes(self) -> Iterator[PermissionChange]:
        """Yield the changes, permissions without parts first; composite permissions cover those of their parts."""
        keys = [(kind, permission) for kind, permissions in PERMISSIONS.items() for permission in permissions]
        composite = [change for key in keys if key in PARTS for change in self._composite(key)]
        explained: dict[PermissionKey, list[Glob]] = {}
        for change in composite:
            pieces = [*part_patterns(change.kind, change.permission, change.objects)]
            if all(self._is_changed(key, piece) for key, piece in pieces):
                for key, piece in pieces:
                    explained.setdefault(key, []).append(piece)
        for key in keys:
            if key not in PARTS:
                for change in self._elementary(key):
                    if not any(covers(outer, change.objects) for outer in explained.get(key, ())):
                        yield change
        yield from composite

    def _is_changed(self, key: PermissionKey, piece: Glob) -> bool:
        return self._is_whole(key[0], piece, decision_list(self.before, key), decision_list(self.after, key))

    def _find(self, kind: str, *lists: DecisionList) -> ProofResult:
        return find_permitted(kind, *lists, budget=self.budget.next_query())

    def _change(
        self, key: PermissionKey, objects: Glob, outcome: Witness | Unknown, whole: bool, where: Origin
    ) -> PermissionChange:
        if isinstance(outcome, Unknown):
            return PermissionChange(self.gains, *key, objects, False, "", where, outcome.reason)
        return PermissionChange(self.gains, *key, objects, whole, outcome.word, where)

    def _elementary(self, key: PermissionKey) -> list[PermissionChange]:
        """Return the changes for a kind and permission without parts."""
        old, new = decision_list(self.before, key), decision_list(self.after, key)
        if isinstance(difference(old, new, universe=universe(key[0]), budget=self.budget.next_query()), Equal):
            return []
        denied = tuple(dict.fromkeys(pattern for block in old if not block.allows for pattern in block.patterns))
        changes: list[PermissionChange] = []
        for rule in self.after:
            if rule.effect is Effect.ALLOW:
                for pattern in object_patterns(rule, key):
                    changes += self._of_pattern(pattern, old, new, denied, key, rule.origin)
        return _maximal(changes)

    def _of_pattern(
        self,
        pattern: Glob,
        old: DecisionList,
        new: DecisionList,
        denied: tuple[Glob, ...],
        key: PermissionKey,
        where: Origin,
    ) -> Iterator[PermissionChange]:
        """Yield the newly allowed part of a pattern: what was denied, and what no rule allowed."""
        kind = key[0]
        allowed_now = restrict_allowed(pattern, new)
        unmatched: DecisionList = (*(block for block in old if not block.allows), *negate(old)[1:])
        outcome = self._find(kind, allowed_now, unmatched)
        if not isinstance(outcome, Equal):
            whole = not any(not disjoint(pattern, each) for each in denied) and self._is_whole(kind, pattern, old, new)
            yield self._change(key, pattern, outcome, whole, where)
        for each in denied:
            for piece in overlap(pattern, each):
                outcome = self._find(kind, allow_only(piece), allow_only(each), allowed_now)
                if not isinstance(outcome, Equal):
                    yield self._change(key, piece, outcome, self._is_whole(kind, piece, old, new), where)

    def _composite(self, key: PermissionKey) -> list[PermissionChange]:
        """Return the changes for a permission with parts: all parts are allowed now, and were not."""
        kind, permission = key
        candidates = {
            parse(expression): rule.origin
            for rule in reversed(self.after)
            if rule.effect is Effect.ALLOW and rule.kind == kind and permission in rule.permissions
            for expression in rule.expressions
        }
        if not candidates:
            return []
        old, new = part_lists(self.before, kind, permission), part_lists(self.after, kind, permission)
        changes: list[PermissionChange] = []
        for pattern, where in candidates.items():
            outcomes = [self._find(kind, allow_only(pattern), *new, negate(part)) for part in old]
            outcome = _shortest(outcomes)
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


def _shortest(outcomes: Sequence[Equal | Witness | Unknown]) -> Witness | Unknown | None:
    witnesses = [each for each in outcomes if isinstance(each, Witness)]
    if witnesses:
        return min(witnesses, key=lambda each: (len(each.word), each.word))
    return next((each for each in outcomes if isinstance(each, Unknown)), None)


def _maximal(changes: Sequence[PermissionChange]) -> list[PermissionChange]:
    """Return the changes whose pattern is not covered by another one."""
    kept: list[PermissionChange] = []
    for at, change in enumerate(changes):
        others = (*kept, *changes[at + 1 :])
        if not any(covers(other.objects, change.objects) and (other.whole or not change.whole) for other in others):
            kept.append(change)
    return kept
