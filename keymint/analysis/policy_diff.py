"""Two policies compared by meaning: what each subject gains and loses, over all subjects and names there are."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from keymint.analysis.pattern_diff import PatternDifference, pattern_differences
from keymint.analysis.query_budget import QueryBudget
from keymint.analysis.rule_diff import PermissionChange, rule_changes
from keymint.analysis.rule_lists import SEPARATOR, display_pattern, pattern_text
from keymint.analysis.subject_patterns import structure
from keymint.analysis.subject_templates import as_written
from keymint.analysis.symbolic_rules import SymbolicRules
from keymint.api import LoadedPolicy
from keymint.graph import Edge, Object
from keymint.ir import Rule

_UNWRITTEN = "the policy type does not tell what its rules say of subjects that a policy does not name"


@dataclass(frozen=True, slots=True)
class SubjectChanges:
    """What changed for a subject.

    Attributes:
        subject: the subject; empty where none was found for certain.
        like: the pattern of subjects that it stands for; empty for one that a policy names.
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
    """Return what changed between two policies, by subject; subjects without a change are left out.

    Subjects are those that either policy names, and of all others one for each pattern and rule that make a difference.
    Where nothing is returned the policies are equivalent, for every subject and every object there is.

    Args:
        old: the older policy.
        new: the newer one.
        budget: pays for it; what is not decided when it is spent is returned as unknown.
    """
    budget = budget or QueryBudget()
    written = [structure(policy) for policy in (old, new)]
    books = [SymbolicRules(each) for each in written if each]
    named = {*old.subjects(), *new.subjects()}.union(*(book.singles for book in books))
    changed = [each for subject in sorted(named) if (each := _of_subject(old, new, subject, "", budget))]
    if len(books) < len(written):
        return [*changed, _undecided("*", _UNWRITTEN)]
    reported: set[tuple[str, str]] = set()
    for found in pattern_differences((old, new), (books[0], books[1]), named, budget):
        like = pattern_text(found.subjects)
        if found.unknown:
            changed.append(_undecided(like, found.unknown, found))
        elif (like, found.subject) not in reported:
            reported.add((like, found.subject))
            each = _of_subject(old, new, found.subject, like, budget)
            changed += [each] if each else []
    return changed


def _of_subject(
    old: LoadedPolicy, new: LoadedPolicy, subject: str, like: str, budget: QueryBudget
) -> SubjectChanges | None:
    """Return what changed for a subject, each example judged by both policies; None if nothing did."""
    before, after = old.rules(subject), new.rules(subject)
    mine, theirs = (each.rules if each else () for each in (before, after))
    changes = () if _same(mine, theirs) else tuple(rule_changes(mine, theirs, budget))
    for change in changes:
        if change.word:
            _judge(old, new, subject, change)
    if changes or (before is None) is not (after is None):
        return SubjectChanges(subject, like, before is not None, after is not None, changes)
    return None


def _judge(old: LoadedPolicy, new: LoadedPolicy, subject: str, change: PermissionChange) -> None:
    """Ask both policies about an example: what an engine says is not taken on trust."""
    partition, _, name = change.word.rpartition(SEPARATOR)
    asked = Object(change.kind, name, (partition,) if partition else ())
    edge = Edge(subject, change.permission, asked)
    if (old.decide(edge).allowed, new.decide(edge).allowed) != (not change.gains, change.gains):
        raise AssertionError(f"the policies do not differ on {edge} as was said")


def _undecided(like: str, reason: str, found: PatternDifference | None = None) -> SubjectChanges:
    """Return what it was not found out whether it changed, for subjects that a pattern matches."""
    if found is None or found.where is None:
        change = PermissionChange(True, "", "", "*", False, "", None, reason)
    else:
        change = PermissionChange(
            found.gains,
            *found.key,
            as_written(display_pattern(found.key[0], found.object)),
            False,
            "",
            found.where,
            reason,
        )
    return SubjectChanges("", like, before=True, after=True, changes=(change,))


def has_gains(found: Iterable[SubjectChanges]) -> bool:
    """Tell whether a subject gains something, or may do so where that was not decided."""
    return any(change.gains or change.unknown for each in found for change in each.changes)


def _same(old: Sequence[Rule], new: Sequence[Rule]) -> bool:
    """Tell whether rules say the same, word by word, whatever their order and place."""
    return {_said(rule) for rule in old} == {_said(rule) for rule in new}


def _said(rule: Rule) -> tuple[object, ...]:
    return rule.effect, rule.kind, rule.permissions, frozenset(rule.expressions), frozenset(rule.partitions)
