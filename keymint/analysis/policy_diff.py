# SPDX-License-Identifier: Apache-2.0
"""Compare two policies semantically: what each subject gains and loses, over all possible subjects and names."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from itertools import product

from comarmor.patterns.decision_lists import Unknown
from comarmor.patterns.glob import literal
from comarmor.patterns.tokens import STAR
from comarmor.values import Data, replace
from keymint.analysis.permission_changes import KEYS, PatternComparison, PermissionChange, Versions, rule_changes
from keymint.analysis.rule_lists import SEPARATOR, pattern_text
from keymint.analysis.subject_classes import ClassFinder
from keymint.analysis.subject_patterns import EVERY, ROOT_ENCLAVE, SubjectClass
from keymint.analysis.symbolic_rules import SymbolicRules, exact_halves, fill_placeholders
from keymint.analysis.symbolic_search import QueryBudget
from keymint.api import LoadedPolicy
from keymint.api.graph import Edge, Object
from keymint.ir import Rule

_UNWRITTEN = "the policy type does not provide its rules for subjects that a policy does not name"


class SubjectChanges(Data):
    """The changes for a subject.

    Attributes:
        subject: the subject; empty if unknown.
        area: the class of subjects of which it is an example; None if the changes are its own. All of them change in
            this way, with their own namespace and name.
        before: the older policy has a profile that applies to it.
        after: the newer one has.
        changes: gains first.
    """

    subject: str
    area: SubjectClass | None
    before: bool
    after: bool
    changes: tuple[PermissionChange, ...]

    @property
    def like(self) -> str:
        """The pattern of the class; empty if there is none."""
        return pattern_text(self.area.like) if self.area else ""

    @property
    def excluded(self) -> tuple[str, ...]:
        """The patterns of the subjects that the class leaves out."""
        return tuple(map(pattern_text, self.area.excluded)) if self.area else ()


def diff_policies(old: LoadedPolicy, new: LoadedPolicy, budget: QueryBudget | None = None) -> list[SubjectChanges]:
    """Return the changes between two policies by subject, without unchanged subjects.

    Includes the subjects that either policy names, and classes of other subjects that change in the same way. An empty
    result proves that the policies are equivalent, for every possible subject and object.

    Args:
        old: the older policy.
        new: the newer one.
        budget: limit of the search; undecided changes are returned as unknown.
    """
    budget = budget or QueryBudget()
    written = [policy.structure() for policy in (old, new)]
    books = [SymbolicRules(each) for each in written if each]
    named = {*old.subjects(), *new.subjects()}.union(*(book.singles for book in books))
    own = {subject: _of_subject(old, new, subject, budget) for subject in sorted(named | {ROOT_ENCLAVE})}
    classes: list[SubjectChanges] = []
    if len(books) < len(written):
        classes.append(_unknown(SubjectClass((STAR,)), _UNWRITTEN))
    else:
        classes += _classes(Versions((old, new), (books[0], books[1]), own.keys(), budget), own)
    # The root enclave is a member of classes, although no profile means it.
    known = (each for each in classes if not any(change.unknown for change in each.changes))
    if ROOT_ENCLAVE not in named and any(each.area and ROOT_ENCLAVE in each.area for each in known):
        del own[ROOT_ENCLAVE]
    return [*(each for each in own.values() if each), *classes]


def _classes(versions: Versions, own: Mapping[str, SubjectChanges | None]) -> Iterator[SubjectChanges]:
    """Yield the changes of classes of subjects that no policy names.

    Args:
        versions: both policies.
        own: the changes of the subjects that are named.
    """
    budget = versions.budget
    comparisons = (PatternComparison(True, versions), PatternComparison(False, versions))
    finder = ClassFinder(versions, comparisons)
    listed: list[SubjectClass] = []
    for comparison, key in product(comparisons, KEYS):
        for rule, within, found in comparison.differences(key, SubjectClass(EVERY), (), listed):
            if isinstance(found, Unknown):
                if budget.is_empty:
                    yield _unknown(SubjectClass(EVERY), budget.reason(found.reason))
                    return
                change = PermissionChange(comparison.gains, *key, rule.object, False, "", rule.where, found.reason)
                yield SubjectChanges("", SubjectClass(within), True, True, (change,))
                continue
            alone = _of_subject(*versions.policies, found, budget)
            if alone is None:
                raise AssertionError(f"the rules of {found} do not differ as reported")
            area, changes, reason = finder.class_of(found, rule, within, alone.changes)
            if reason:
                listed.append(area)
                yield from (alone, _unknown(area, f"not listed: {reason}"))
                continue
            alike = replace(alone, changes=changes)
            others = [(name,) for name, each in own.items() if name in area and not _is_alike(alike, each, name)]
            area = replace(area, excluded=(*area.excluded, *others))
            listed.append(area)
            yield alone if literal(area.like) else replace(alike, area=area)


def _is_alike(found: SubjectChanges, each: SubjectChanges | None, name: str) -> bool:
    """Return True if a named subject surely changes as a class does."""
    if each is None or (each.before, each.after) != (found.before, found.after):
        return False
    if not all(change.whole for change in (*found.changes, *each.changes)):
        return False
    return {_said(change, name) for change in found.changes} == {_said(change, name) for change in each.changes}


def _said(change: PermissionChange, name: str) -> tuple[object, ...]:
    return change.gains, change.kind, change.permission, fill_placeholders(change.objects, *exact_halves(name))


def _of_subject(old: LoadedPolicy, new: LoadedPolicy, subject: str, budget: QueryBudget) -> SubjectChanges | None:
    """Return the changes for a subject, if there are any, with examples checked by both policies."""
    before, after = old.rules(subject), new.rules(subject)
    old_rules, new_rules = (each.rules if each else () for each in (before, after))
    # Rules that are textually the same, in any order and place, have no changes.
    is_same = {*map(_content, old_rules)} == {*map(_content, new_rules)}
    changes = () if is_same else tuple(rule_changes(old_rules, new_rules, budget))
    for change in (each for each in changes if each.word):
        partition, _, name = change.word.rpartition(SEPARATOR)
        edge = Edge(subject, change.permission, Object(change.kind, name, (partition,) if partition else ()))
        if (old.decide(edge).allowed, new.decide(edge).allowed) != (not change.gains, change.gains):
            raise AssertionError(f"the policies do not differ on {edge} as reported")
    if not changes and (before is None) is (after is None):
        return None
    return SubjectChanges(subject, None, before is not None, after is not None, changes)


def _unknown(area: SubjectClass, reason: str) -> SubjectChanges:
    """Return an unknown change of any permission."""
    change = PermissionChange(True, "", "", (STAR,), False, "", None, reason)
    return SubjectChanges("", area, before=True, after=True, changes=(change,))


def has_gains(changed: Iterable[SubjectChanges]) -> bool:
    """Return True if a subject gains something, or may gain something in an unknown change."""
    return any(change.gains or change.unknown for each in changed for change in each.changes)


def _content(rule: Rule) -> tuple[object, ...]:
    return rule.effect, rule.kind, rule.permissions, frozenset(rule.expressions), frozenset(rule.partitions)
