# SPDX-License-Identifier: Apache-2.0
"""Check whether a denial may have an effect for a subject that a policy does not name.

Examples do not show this where rules depend on the subject by ``{namespace}`` and ``{name}``: an ALLOW may overlap the
denial for just one subject of a pattern.
"""

from __future__ import annotations

from collections.abc import Iterator

from comarmor.patterns.decision_lists import Equal, Unknown
from comarmor.patterns.glob import Glob, literal
from comarmor.patterns.relations import TooComplexError, disjoint
from comarmor.rules import Effect
from keymint.analysis.rule_lists import (
    PermissionKey,
    allow_only,
    find_permitted,
    pattern_text,
    permission_keys,
    rule_patterns,
)
from keymint.analysis.subject_patterns import namespace_name_splits, profile_subjects
from keymint.api import PolicyStructure, WrittenRule


def may_deny_something(written: PolicyStructure, clause: WrittenRule, at: int) -> bool:
    """Return True if a rule may allow something that an expression of a DENY rule denies.

    Rules that depend on the subject in the same way are ignored: any example shows their overlap.

    Args:
        written: structure of the policy.
        clause: the DENY rule.
        at: index of the expression.

    Raises:
        TooComplexError: the answer is unknown.
        StepLimitError: the check takes too many steps.
    """
    prefix = _subject_prefix(clause, at)
    others = [
        (other, number)
        for other in written.clauses
        if other.rule.effect is Effect.ALLOW
        and not set(permission_keys(other.rule)).isdisjoint(permission_keys(clause.rule))
        for number in range(len(other.places))
        if prefix is None or _subject_prefix(other, number) != prefix
    ]
    return any(
        _overlap(key[0], one, two)
        for other, number in others
        for key in permission_keys(clause.rule)
        for subjects in profile_subjects((*clause.profiles, *other.profiles))
        if literal(subjects) is None
        for one in _object_patterns(clause, at, subjects, key)
        for two in _object_patterns(other, number, subjects, key)
    )


def _subject_prefix(clause: WrittenRule, at: int) -> str | None:
    """Return the subject-dependent prefix of an expression whose rest is fixed; None for other expressions."""
    one, other = (clause.expand(namespace, name)[at] for namespace, name in (("/a/", "a"), ("/b/", "b")))
    for prefix in ("", "/{}/", "/{}/{}"):
        prefix1, prefix2 = prefix.format("a", "a"), prefix.format("b", "b")
        if one.startswith(prefix1) and other.startswith(prefix2) and one[len(prefix1) :] == other[len(prefix2) :]:
            return prefix
    return None


def _object_patterns(clause: WrittenRule, at: int, subjects: Glob, key: PermissionKey) -> Iterator[Glob]:
    """Yield patterns that together match the objects of an expression for any subject of a pattern."""
    for namespace, name in namespace_name_splits(subjects):
        yield from rule_patterns(clause.rule, clause.expand(pattern_text(namespace), pattern_text(name))[at], key)


def _overlap(kind: str, one: Glob, other: Glob) -> bool:
    if disjoint(one, other):
        return False
    outcome = find_permitted(kind, allow_only(one), allow_only(other))
    if isinstance(outcome, Unknown):
        raise TooComplexError
    return not isinstance(outcome, Equal)
