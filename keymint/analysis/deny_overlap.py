"""Whether a denial may matter to a subject that a policy does not name.

Where rules depend on the subject by ``{namespace}`` and ``{name}``, examples do not show it: what a denial is about may
be allowed to just one subject of a pattern.
"""

from __future__ import annotations

from collections.abc import Iterator

from comarmor.patterns.decision_lists import Equal, Unknown
from comarmor.patterns.glob import Glob, literal
from comarmor.patterns.relations import TooComplexError, disjoint
from comarmor.rules import Effect
from keymint.analysis.rule_lists import PermissionKey, allowed, keys, meet, patterns, text
from keymint.analysis.subject_patterns import namespace_name_splits, profile_subjects
from keymint.api import PolicyStructure, WrittenRule


def may_deny_something(written: PolicyStructure, clause: WrittenRule, at: int) -> bool:
    """Tell whether a rule may allow something that an expression of a DENY rule denies.

    Left out are rules that depend on the subject in the same way: any example shows what they have in common.

    Args:
        written: the policy.
        clause: the DENY rule.
        at: which of its expressions.

    Raises:
        TooComplexError: that was not decided.
        EffortError: it takes too many steps.
    """
    begins = _beginning(clause, at)
    others = [
        (other, number)
        for other in written.clauses
        if other.rule.effect is Effect.ALLOW and not set(keys(other.rule)).isdisjoint(keys(clause.rule))
        for number in range(len(other.places))
        if begins is None or _beginning(other, number) != begins
    ]
    return any(
        _overlap(key[0], one, two)
        for other, number in others
        for key in keys(clause.rule)
        for subjects in profile_subjects((*clause.profiles, *other.profiles))
        if literal(subjects) is None
        for one in _about(clause, at, subjects, key)
        for two in _about(other, number, subjects, key)
    )


def _beginning(clause: WrittenRule, at: int) -> str | None:
    """Return with what of its subject an expression begins that otherwise does not depend on it; None for others."""
    one, other = (clause.expand(namespace, name)[at] for namespace, name in (("/a/", "a"), ("/b/", "b")))
    for beginning in ("", "/{}/", "/{}/{}"):
        mine, theirs = beginning.format("a", "a"), beginning.format("b", "b")
        if one.startswith(mine) and other.startswith(theirs) and one[len(mine) :] == other[len(theirs) :]:
            return beginning
    return None


def _about(clause: WrittenRule, at: int, subjects: Glob, key: PermissionKey) -> Iterator[Glob]:
    """Yield patterns that together match what an expression is about for any of some subjects."""
    for namespace, name in namespace_name_splits(subjects):
        yield from patterns(clause.rule, clause.expand(text(namespace), text(name))[at], key)


def _overlap(kind: str, one: Glob, other: Glob) -> bool:
    if disjoint(one, other):
        return False
    found = meet(kind, allowed(one), allowed(other))
    if isinstance(found, Unknown):
        raise TooComplexError
    return not isinstance(found, Equal)
