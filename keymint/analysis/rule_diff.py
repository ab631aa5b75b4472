"""The rules of a subject, compared by meaning: what it gains and loses, over all names there are."""

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
        gains: the newer policy allows what the older does not; else the other way round.
        kind: kind of the objects.
        permission: the permission.
        pattern: expression of the objects, with the partition if it is not the default one.
        whole: all that the pattern matches changes; else some of it was so before, or is denied.
        word: the shortest name that changes, with the partition for kind ``topic``; empty if that was not decided.
        where: the rule that allows it; None where that was not decided.
        unknown: why it was not decided; empty if it was.
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
        """The shortest name that changes, for a person."""
        return display_name(self.kind, self.word)


def rule_changes(
    old: Sequence[Rule], new: Sequence[Rule], budget: QueryBudget | None = None
) -> Iterator[PermissionChange]:
    """Yield what a subject gains and loses when its rules change, gains first.

    Args:
        old: its older rules.
        new: its newer ones.
        budget: pays for it.
    """
    budget = budget or QueryBudget()
    for is_gain, before, after in ((True, old, new), (False, new, old)):
        for kind, permission, pattern, example, whole, where, unknown in _RuleComparison(before, after, budget).found():
            yield PermissionChange(
                is_gain, kind, permission, display_pattern(kind, pattern), whole, example, where, unknown
            )


_Found = tuple[str, str, Glob, str, bool, Origin, str]
"""Kind, permission, pattern, example, whether all of the pattern changes, the rule that allows it, and why unknown."""


class _RuleComparison:
    """What a subject may do by some rules, and not by other ones.

    Args:
        before: the rules that do not allow it.
        after: the rules that do.
        budget: pays for it.
    """

    def __init__(self, before: Sequence[Rule], after: Sequence[Rule], budget: QueryBudget) -> None:
        self._before = before
        self._after = after
        self._budget = budget

    def found(self) -> Iterator[_Found]:
        """Yield what the rules make a difference to: permissions without parts first."""
        all_ = [(kind, permission) for kind, held in PERMISSIONS.items() for permission in held]
        composite = [found for key in all_ if is_composite(*key) for found in self._composite(*key)]
        explained: dict[PermissionKey, list[Glob]] = {}
        for kind, permission, pattern, *_ in composite:
            pieces = [((of, part), surround("", pattern, suffix)) for of, part, suffix in parts(kind, permission)]
            if all(self._is_changed(key, piece) for key, piece in pieces):
                for key, piece in pieces:
                    explained.setdefault(key, []).append(piece)
        for key in all_:
            if not is_composite(*key):
                for found in self._elementary(key):
                    if not any(covers(outer, found[2]) for outer in explained.get(key, ())):
                        yield found
        yield from composite

    def _is_changed(self, key: PermissionKey, piece: Glob) -> bool:
        return self._is_whole(key[0], piece, decision_list(self._before, key), decision_list(self._after, key))

    def _meet(self, kind: str, *lists: DecisionList) -> ProofResult:
        return find_permitted(kind, *lists, budget=self._budget.next_query())

    def _elementary(self, key: PermissionKey) -> list[_Found]:
        """Return what rules allow of a kind and permission without parts that earlier ones do not."""
        old, new = decision_list(self._before, key), decision_list(self._after, key)
        if isinstance(difference(old, new, universe=universe(key[0]), budget=self._budget.next_query()), Equal):
            return []
        denied = tuple(dict.fromkeys(pattern for block in old if not block.allows for pattern in block.patterns))
        found: list[_Found] = []
        for rule in self._after:
            if rule.effect is not Effect.ALLOW or key not in permission_keys(rule):
                continue
            for expression in rule.expressions:
                for pattern in rule_patterns(rule, expression, key):
                    found += self._of_pattern(pattern, old, new, denied, key, rule.origin)
        return _largest(found)

    def _of_pattern(
        self,
        pattern: Glob,
        old: DecisionList,
        new: DecisionList,
        denied: tuple[Glob, ...],
        key: PermissionKey,
        where: Origin,
    ) -> Iterator[_Found]:
        """Yield what of a pattern is allowed now and was not: what was denied, and what nothing allowed."""
        kind, permission = key
        mine = restrict_allowed(pattern, new)
        unspoken: DecisionList = (*(block for block in old if not block.allows), *negated(old)[1:])
        outcome = self._meet(kind, mine, unspoken)
        if not isinstance(outcome, Equal):
            whole = not any(not disjoint(pattern, each) for each in denied) and self._is_whole(kind, pattern, old, new)
            yield _found(key, pattern, outcome, whole, where)
        for each in denied:
            try:
                pieces = intersection(pattern, each)
            except TooComplexError:
                pieces = (pattern,)
            for piece in pieces:
                outcome = self._meet(kind, allow_only(piece), allow_only(each), mine)
                if not isinstance(outcome, Equal):
                    yield _found((kind, permission), piece, outcome, self._is_whole(kind, piece, old, new), where)

    def _composite(self, kind: str, permission: str) -> list[_Found]:
        """Return what rules allow of a permission with parts, all of them, that earlier rules do not."""
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
        found: list[_Found] = []
        for pattern, where in candidates.items():
            outcomes = [self._meet(kind, allow_only(pattern), *new, negated(part)) for part in old]
            outcome = _shortest(outcomes)
            if outcome is not None:
                had = not isinstance(self._meet(kind, allow_only(pattern), *old), Equal)
                lacks = any(not isinstance(self._meet(kind, allow_only(pattern), negated(part)), Equal) for part in new)
                found.append(_found((kind, permission), pattern, outcome, not had and not lacks, where))
        return _largest(found)

    def _is_whole(self, kind: str, pattern: Glob, old: DecisionList, new: DecisionList) -> bool:
        """Tell whether the older list refuses, and the newer one permits, all that a pattern matches."""
        refused_before = self._meet(kind, allow_only(pattern), old)
        refused_now = self._meet(kind, allow_only(pattern), negated(new))
        return isinstance(refused_before, Equal) and isinstance(refused_now, Equal)


def _shortest(outcomes: Sequence[Equal | Witness | Unknown]) -> Witness | Unknown | None:
    witnesses = [each for each in outcomes if isinstance(each, Witness)]
    if witnesses:
        return min(witnesses, key=lambda each: (len(each.word), each.word))
    return next((each for each in outcomes if isinstance(each, Unknown)), None)


def _found(key: PermissionKey, pattern: Glob, outcome: Witness | Unknown, whole: bool, where: Origin) -> _Found:
    if isinstance(outcome, Unknown):
        return (*key, pattern, "", False, where, outcome.reason)
    return (*key, pattern, outcome.word, whole, where, "")


def _largest(found: Sequence[_Found]) -> list[_Found]:
    """Leave out what another pattern says as well."""
    kept: list[_Found] = []
    for at, one in enumerate(found):
        others = (*kept, *found[at + 1 :])
        if not any(covers(other[2], one[2]) and (other[4] or not one[4]) for other in others):
            kept.append(one)
    return kept
