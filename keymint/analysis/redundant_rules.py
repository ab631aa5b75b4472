# SPDX-License-Identifier: Apache-2.0
"""Find rules without effect: unreachable rules, and rules that repeat others.

Every check has a limit of steps, and so have all checks together. Checks that reach it are reported as unknown.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cache, cached_property
from itertools import groupby
from operator import itemgetter
from typing import NamedTuple

from comarmor.patterns.decision_lists import Block, Equal, ProofResult, Unknown
from comarmor.patterns.glob import Glob
from comarmor.patterns.pattern_index import PatternIndex
from comarmor.patterns.proofs import escapes
from comarmor.patterns.relations import TooComplexError
from comarmor.patterns.steps import StepLimitError, step_limit
from comarmor.patterns.tokens import SPECIAL
from comarmor.rules import Effect, parts
from keymint.analysis.findings import ExpressionOrigin, ExpressionOrigins, quoted_list, undecided_note
from keymint.analysis.rule_lists import (
    PermissionKey,
    allow_only,
    find_permitted,
    is_possible,
    legal_names,
    permission_keys,
    restrict_allowed,
    rule_patterns,
    universe,
)
from keymint.analysis.subject_patterns import SubjectClass, profile_subjects, rules_of, with_distinct_rules
from keymint.analysis.symbolic_rules import SymbolicRules, placeholders, symbolic_patterns
from keymint.api import LoadedPolicy, PolicyStructure
from keymint.errors import Diagnostic, Origin, Spot
from keymint.ir import Rule

UNIT = 300_000
"""Maximum steps of the checks of one expression."""
TOGETHER = 20_000_000
"""Maximum steps of all checks, and :data:`EACH` more for each expression."""
EACH = 1_000
MOST_PAIRS = 1_000_000
"""Maximum number of checked pairs of a subject and a rule."""


class _RuleExpression(NamedTuple):
    """An expression of a rule in a policy, the same one for all subjects.

    The spot of its attachment and its number there identify it, as its text may depend on the subject.
    """

    place: Spot
    effect: Effect
    attached: Spot
    number: int


_Side = tuple[PermissionKey, Effect]


class _RuleAnalysis:
    """The rules of one subject; of those that many subjects have, few are asked about for each of them.

    Attributes:
        expanded: rule, text and attachment of each expression.
    """

    def __init__(self, rules: Sequence[Rule], subject: str, attachments: ExpressionOrigins) -> None:
        self.expanded: dict[_RuleExpression, tuple[Rule, str, Origin]] = {}
        self._texts: dict[_RuleExpression, list[tuple[Rule, str]]] = defaultdict(list)
        self._index: dict[_Side, PatternIndex[_RuleExpression]] = {}
        for rule in rules:
            attached = attachments.of(rule, subject)
            for text in rule.expressions:
                attachment = attached[text]
                expression = _RuleExpression(rule.origin.spot, rule.effect, attachment.where.spot, attachment.number)
                self.expanded.setdefault(expression, (rule, text, attachment.where))
                self._texts[expression].append((rule, text))

    def patterns(self, expression: _RuleExpression) -> Iterable[tuple[PermissionKey, Glob]]:
        """Return the patterns of an expression, each with a kind and permission."""
        keyed = ((rule, text, key) for rule, text in self._texts[expression] for key in permission_keys(rule))
        return dict.fromkeys((key, pattern) for rule, text, key in keyed for pattern in rule_patterns(rule, text, key))

    def index(self, key: PermissionKey, effect: Effect) -> PatternIndex[_RuleExpression]:
        """Return the patterns of a kind, permission and effect with their expressions."""
        if (key, effect) not in self._index:
            patterns = ((each, *of) for each in self._texts if each.effect is effect for of in self.patterns(each))
            self._index[key, effect] = PatternIndex((pattern, each) for each, own, pattern in patterns if own == key)
        return self._index[key, effect]


def _repeat_nothing(rules: Iterable[Rule]) -> bool:
    """Return True if each rule of a subject surely has an effect: it allows names, and no two allow the same name."""
    words: list[tuple[str, str, str]] = []
    for rule in rules:
        plain = rule.effect is Effect.ALLOW and rule.permissions and not rule.partitions
        if not plain or any(map(SPECIAL.search, rule.expressions)):
            return False
        every_part = (each for permission in rule.permissions for each in parts(rule.kind, permission))
        words += [(kind, part, text + suffix) for kind, part, suffix in every_part for text in rule.expressions]
    return len(set(words)) == len(words)


class RedundantRules:
    """Finds rules without effect.

    An expression that has an effect for one subject needs it. So subjects whose rules repeat nothing, as most in a
    fleet, are looked at only for what they share with others.

    Args:
        subjects: rules of each subject.
        attachments: attachments of their expressions.
        written: structure of the policy, if its type provides it.
    """

    def __init__(
        self, subjects: Mapping[str, tuple[Rule, ...]], attachments: ExpressionOrigins, written: PolicyStructure | None
    ) -> None:
        self._attachments = attachments
        self._written = written
        self._subjects: dict[str, _RuleAnalysis] = {}
        self._plain_at: dict[Spot, list[str]] = defaultdict(list)
        """The subjects that repeat nothing, by the places of their rules."""
        for subject, rules in with_distinct_rules(subjects.items()):
            if not _repeat_nothing(rules):
                self._subjects[subject] = _RuleAnalysis(rules, subject, attachments)
                continue
            for rule in rules:
                self._plain_at[rule.origin.spot].append(subject)
        self._subjects_of: dict[_RuleExpression, list[str]] = defaultdict(list)
        for subject, its_rules in self._subjects.items():
            for each in its_rules.expanded:
                self._subjects_of[each].append(subject)
        self._count_of_rule = Counter((each.place, each.effect) for each in self._subjects_of)
        self._removed: set[_RuleExpression] = set()
        self._unknown: list[_RuleExpression] = []
        self._expanded = cache(lambda subject: _RuleAnalysis(subjects[subject], subject, attachments).expanded)

    @cached_property
    def _book(self) -> SymbolicRules | None:
        return SymbolicRules(self._written) if self._written else None

    def _is_needed(self, expression: _RuleExpression) -> bool:
        """Return True if a subject that repeats nothing has an expression."""
        return any(expression in self._expanded(subject) for subject in self._plain_at.get(expression.place, ()))

    def findings(self) -> Iterator[Diagnostic]:
        """Yield findings: one for a rule if it concerns all its expressions, else one for each attachment.

        Expressions that no object can match are left out: they are reported as such.
        """
        by_code: dict[tuple[Spot, str], list[_RuleExpression]] = defaultdict(list)
        with step_limit(TOGETHER + EACH * len(self._subjects_of)):
            # In reverse order: of two equal rules the later one is redundant, and it is no reason to remove the other.
            for each in sorted(
                self._subjects_of, key=lambda each: (each.place, each.attached, each.number), reverse=True
            ):
                code = "" if self._is_needed(each) else self._code_or_unknown(each)
                if code:
                    self._removed.add(each)
                    by_code[each.place, code].append(each)
        for (place, code), expressions in by_code.items():
            number = self._count_of_rule[place, expressions[0].effect]
            if number == len(expressions) and place not in self._plain_at:
                yield self._finding(code, expressions[::-1], of_rule=True)
                continue
            by_attachment: dict[Spot, list[_RuleExpression]] = defaultdict(list)
            for each in expressions[::-1]:
                by_attachment[each.attached].append(each)
            for together in by_attachment.values():
                yield self._finding(code, together, of_rule=False)
        if self._unknown:
            rule, text, where = self._an_expansion(self._unknown[-1])
            more = f" and {len(self._unknown) - 1:,} other expressions" if len(self._unknown) > 1 else ""
            yield undecided_note(
                f"whether {text!r} in this {rule.effect} {rule.kind} rule{more} is redundant is unknown: "
                "it overlaps with others in too many ways",
                "use fewer expressions with wildcards for one subject, or lint parts of the policy",
                where,
            )

    def _code_or_unknown(self, expression: _RuleExpression) -> str:
        """Return the code of the finding on an expression, or an empty text; record it if that takes too many steps."""
        try:
            with step_limit(UNIT):
                code = self._code(expression)
                expanded = (self._subjects[each].expanded[expression] for each in self._subjects_of[expression])
                texts = dict.fromkeys((rule, text) for rule, text, _ in expanded) if code else ()
                if code and not any(can_name_exist(rule, text) for rule, text in texts):
                    self._removed.add(expression)  # reported as object-never, and no reason for other findings
                    return ""
                return code
        except (StepLimitError, TooComplexError):
            self._unknown.append(expression)
            return ""

    def _an_expansion(self, expression: _RuleExpression) -> tuple[Rule, str, Origin]:
        """Return rule, text and attachment of an expression for its first subject."""
        return self._subjects[self._subjects_of[expression][0]].expanded[expression]

    def _code(self, expression: _RuleExpression) -> str:
        subjects = self._subjects_of[expression]

        def is_covered(effect: Effect) -> bool:
            return all(self._is_covered(subject, expression, effect) for subject in subjects)

        if expression.effect is Effect.DENY:
            denies_nothing = all(self._denies_nothing(subject, expression) for subject in subjects)
            if denies_nothing and not self._may_deny_something(expression):
                return "deny-nothing"
            return "deny-redundant" if is_covered(Effect.DENY) else ""
        if is_covered(Effect.DENY):
            return "rule-shadowed"
        return "rule-redundant" if is_covered(Effect.ALLOW) else ""

    def _overlapping(
        self, subject: str, key: PermissionKey, effect: Effect, pattern: Glob
    ) -> Iterator[tuple[Glob, _RuleExpression]]:
        return self._subjects[subject].index(key, effect).meeting(pattern)

    def _is_covered(self, subject: str, expression: _RuleExpression, effect: Effect) -> bool:
        """Return True if other rules of an effect match all that an expression matches."""
        for key, pattern in self._subjects[subject].patterns(expression):
            overlapping = self._overlapping(subject, key, effect, pattern)
            others = (other for other, owner in overlapping if owner != expression and owner not in self._removed)
            covering = Block(True, tuple(dict.fromkeys(others)))
            legal = restrict_allowed(pattern, legal_names(key[0]))
            if not (covering.patterns and _is_proven(escapes([legal], (covering,), universe(key[0])))):
                return False
        return True

    def _denies_nothing(self, subject: str, expression: _RuleExpression) -> bool:
        """Return True if no rule allows anything that an expression denies."""
        for key, pattern in self._subjects[subject].patterns(expression):
            # Includes rules reported as shadowed: this expression may shadow them.
            others = dict.fromkeys(other for other, _ in self._overlapping(subject, key, Effect.ALLOW, pattern))
            allowed = (Block(True, tuple(others)),)
            if others and not _is_proven(find_permitted(key[0], allow_only(pattern), allowed)):
                return False
        return True

    def _may_deny_something(self, expression: _RuleExpression) -> bool:
        """Return True if a denial may have an effect for a subject that is no example."""
        if self._book is None:
            return False
        expanded = (self._subjects[subject].expanded[expression] for subject in self._subjects_of[expression])
        clauses = {
            self._attachments.clause(rule, ExpressionOrigin(where, expression.number)) for rule, _, where in expanded
        }
        return any(
            # Any example shows whether rules overlap that do not depend on the subject.
            placeholders((*pattern, *rule.object)) and rule.may_meet(pattern, SubjectClass(subjects))
            for clause, at in filter(None, clauses)
            for key in permission_keys(clause.rule)
            for pattern in symbolic_patterns(clause, key, at)
            for subjects in profile_subjects(clause.profiles)
            for rule in self._book.applying(key, Effect.ALLOW, subjects)
        )

    def _finding(self, code: str, expressions: Sequence[_RuleExpression], *, of_rule: bool) -> Diagnostic:
        rule, _, attached = self._an_expansion(expressions[0])
        texts = [self._an_expansion(each)[1] for each in expressions]
        permissions = ", ".join(rule.permissions)
        by = self._example_place(expressions, Effect.ALLOW if code == "rule-redundant" else Effect.DENY)
        problem, help_ = {
            "rule-shadowed": (
                f"is unreachable: DENY rules override all of it{by}",
                "remove it, or narrow the DENY: a DENY overrides every ALLOW",
            ),
            "rule-redundant": (f"is redundant: other rules allow all of it{by}", "remove it, or narrow the other"),
            "deny-redundant": (f"is redundant: other rules deny all of it{by}", "remove it, or narrow the other"),
            "deny-nothing": (
                "denies nothing that any rule allows",
                "remove it, or fix its attachment: without an ALLOW everything is denied",
            ),
        }[code]
        subject = f"{'' if of_rule else f'{quoted_list(texts)} in '}this {rule.effect} {rule.kind} rule"
        where = rule.origin if of_rule else attached
        return Diagnostic.warning(code, f"{subject} ({permissions}) {problem}", where, help_)

    def _example_place(self, expressions: Iterable[_RuleExpression], effect: Effect) -> str:
        """Return the place of an overlapping expression of an effect, as text for a message."""
        for each in expressions:
            subject = self._subjects_of[each][0]
            its_rules = self._subjects[subject]
            for key, patterns in groupby(its_rules.patterns(each), key=itemgetter(0)):
                overlapping = {
                    other for _, pattern in patterns for _, other in self._overlapping(subject, key, effect, pattern)
                }
                for other in its_rules.expanded if overlapping else ():
                    if other in overlapping and other != each and other not in self._removed:
                        return f", e.g. at {its_rules.expanded[other][2].alone()}"
        return ""


def can_name_exist(rule: Rule, expression: str) -> bool:
    """Return True unless no legal name matches an expression of a rule."""
    keys = permission_keys(rule)
    return any(is_possible(key[0], pattern) for key in keys for pattern in rule_patterns(rule, expression, key))


def _is_proven(outcome: ProofResult) -> bool:
    """Return True for a proven answer.

    Raises:
        StepLimitError: it is unknown.
    """
    if isinstance(outcome, Unknown):
        raise StepLimitError(UNIT)
    return isinstance(outcome, Equal)


def within_bounds(policy: LoadedPolicy, subjects: Iterable[str]) -> tuple[Mapping[str, tuple[Rule, ...]], bool]:
    """Return the rules of subjects, up to :data:`MOST_PAIRS` rules, and whether these are all subjects."""
    within: dict[str, tuple[Rule, ...]] = {}
    pairs = 0
    for subject in subjects:
        if pairs >= MOST_PAIRS:
            return within, False
        within[subject] = rules_of(policy, subject)
        pairs += len(within[subject])
    return within, True
