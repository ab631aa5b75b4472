# SPDX-License-Identifier: Apache-2.0
"""Compare two policies semantically: what each subject gains and loses, over all possible subjects and names."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from comarmor.patterns.expression import matches
from comarmor.values import dataclass
from keymint.analysis.pattern_diff import pattern_differences
from keymint.analysis.query_budget import QueryBudget
from keymint.analysis.root_names import ROOT_ENCLAVE
from keymint.analysis.rule_diff import PermissionChange, rule_changes, unknown_change
from keymint.analysis.rule_lists import SEPARATOR, pattern_text
from keymint.analysis.subject_patterns import structure
from keymint.analysis.symbolic_rules import SymbolicRules
from keymint.api import LoadedPolicy
from keymint.graph import Edge, Object
from keymint.ir import Rule

_UNWRITTEN = "the policy type does not provide its rules for subjects that a policy does not name"


@dataclass(frozen=True, slots=True)
class SubjectChanges:
    """The changes for a subject.

    Attributes:
        subject: the subject; empty if unknown.
        like: the pattern of subjects that it is an example of; empty for one that a policy names.
        before: the older policy has a profile that applies to it.
        after: the newer one has.
        changes: gains first.
    """

    subject: str
    like: str
    before: bool
    after: bool
    changes: tuple[PermissionChange, ...]


def diff_policies(old: LoadedPolicy, new: LoadedPolicy, budget: QueryBudget | None = None) -> list[SubjectChanges]:
    """Return the changes between two policies by subject, without unchanged subjects.

    Includes the subjects that either policy names, and an example for each pattern of other subjects and rule with a
    difference. An empty result proves that the policies are equivalent, for every possible subject and object.

    Args:
        old: the older policy.
        new: the newer one.
        budget: limit of the search; undecided changes are returned as unknown.
    """
    budget = budget or QueryBudget()
    written = [structure(policy) for policy in (old, new)]
    books = [SymbolicRules(each) for each in written if each]
    named = {*old.subjects(), *new.subjects()}.union(*(book.singles for book in books))
    changed = [each for subject in sorted(named) for each in _of_subject(old, new, subject, "", budget)]
    if len(books) < len(written):
        return [*changed, _unknown("*", unknown_change(_UNWRITTEN))]
    reported: set[tuple[str, str]] = set()
    for subjects, difference in pattern_differences((old, new), (books[0], books[1]), named, budget):
        like = pattern_text(subjects)
        if isinstance(difference, PermissionChange):
            changed.append(_unknown(like, difference))
        elif (like, difference) not in reported:
            reported.add((like, difference))
            changed += _of_subject(old, new, difference, like, budget)
    # Patterns are compared by the names of nodes, which the root enclave does not have.
    patterns = {each.like for each in changed if each.like}
    if ROOT_ENCLAVE not in named and not any(matches(like, ROOT_ENCLAVE) for like in patterns):
        changed += _of_subject(old, new, ROOT_ENCLAVE, "", budget)
    return changed


def _of_subject(
    old: LoadedPolicy, new: LoadedPolicy, subject: str, like: str, budget: QueryBudget
) -> Iterator[SubjectChanges]:
    """Yield the changes for a subject, if there are any, with examples checked by both policies."""
    before, after = old.rules(subject), new.rules(subject)
    old_rules, new_rules = (each.rules if each else () for each in (before, after))
    changes = () if _same(old_rules, new_rules) else tuple(rule_changes(old_rules, new_rules, budget))
    for change in changes:
        if change.word:
            _check_example(old, new, subject, change)
    if changes or (before is None) is not (after is None):
        yield SubjectChanges(subject, like, before is not None, after is not None, changes)


def _check_example(old: LoadedPolicy, new: LoadedPolicy, subject: str, change: PermissionChange) -> None:
    """Check an example of the proof engine with both policies."""
    partition, _, name = change.word.rpartition(SEPARATOR)
    edge = Edge(subject, change.permission, Object(change.kind, name, (partition,) if partition else ()))
    if (old.decide(edge).allowed, new.decide(edge).allowed) != (not change.gains, change.gains):
        raise AssertionError(f"the policies do not differ on {edge} as reported")


def _unknown(like: str, change: PermissionChange) -> SubjectChanges:
    return SubjectChanges("", like, before=True, after=True, changes=(change,))


def has_gains(changed: Iterable[SubjectChanges]) -> bool:
    """Return True if a subject gains something, or may gain something in an unknown change."""
    return any(change.gains or change.unknown for each in changed for change in each.changes)


def _same(old: Sequence[Rule], new: Sequence[Rule]) -> bool:
    """Return True if rules are textually the same, in any order and place."""
    return {_content(rule) for rule in old} == {_content(rule) for rule in new}


def _content(rule: Rule) -> tuple[object, ...]:
    return rule.effect, rule.kind, rule.permissions, frozenset(rule.expressions), frozenset(rule.partitions)
