# SPDX-License-Identifier: Apache-2.0
"""Check the expectations of policy tests, and which rules they cover."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from comarmor.patterns.decision_lists import Equal, Witness, negate
from comarmor.patterns.glob import Glob, matches, parse
from comarmor.patterns.relations import disjoint
from comarmor.rules import Effect
from comarmor.values import Data
from keymint.analysis import rule_lists
from keymint.analysis.query import who_can
from keymint.analysis.subject_patterns import can_exist, named_subjects, pattern_examples, rules_of, unknown_subject
from keymint.api import Expectation, LoadedPolicy
from keymint.errors import Diagnostic, KeymintError, Origin, Spot
from keymint.ir import Rule
from keymint.names import typed_permission, typed_subject


class ExpectationResult(Data):
    """The result of an expectation.

    Attributes:
        expectation: the expectation.
        failure: why it fails, on one line; empty if it holds.
        rule: the rule that violates it, if any.
        doubt: why it may not mean what was intended, or empty.
        exercised: spots of the rules that it covers.
    """

    expectation: Expectation
    failure: str
    rule: Origin | None
    doubt: str
    exercised: frozenset[Spot]


class ExpectationChecker:
    """Checks expectations of a policy.

    Args:
        policy: the policy.
    """

    def __init__(self, policy: LoadedPolicy) -> None:
        self._policy = policy
        self._rules: Mapping[str, tuple[Rule, ...]] = {
            subject: rules_of(policy, subject) for subject in (*policy.subjects(), *pattern_examples(policy))
        }

    def rules(self) -> dict[Spot, Rule]:
        """Return all rules that apply to any subject, by spot."""
        return {rule.origin.spot: rule for rules in self._rules.values() for rule in rules}

    def check(self, expected: Expectation) -> ExpectationResult:
        """Check an expectation.

        Raises:
            KeymintError: it has an unknown permission, or no legal subject or object name matches it.
        """
        try:
            kind, permission = typed_permission(expected.permission, expected.object, expected.kind)
        except KeymintError as error:
            raise error.at(expected.where) from None
        within = parse(typed_subject(expected.subject))
        if not can_exist(within):
            raise _matches_nothing(f"no legal subject name matches {expected.subject!r}", expected.subject, expected)
        name = rule_lists.query_pattern(kind, expected.object, expected.partition)
        if not rule_lists.is_possible(kind, name):
            message = f"no legal object name matches {expected.object!r}, so the expectation always holds"
            raise _matches_nothing(message, expected.object, expected)
        check = self._check_allow if expected.allowed else self._check_deny
        failure, rule = check(within, kind, permission, name)
        exercised = frozenset(self._exercised(expected, within, kind, permission, name))
        return ExpectationResult(expected, failure, rule, unknown_subject(self._policy, within), exercised)

    def _check_allow(self, within: Glob, kind: str, permission: str, name: Glob) -> tuple[str, Origin | None]:
        """Check that all matching subjects that the policy names have a permission on all names."""
        subjects = named_subjects(self._policy, within)
        if not subjects:
            return "the policy names no subject that matches it", None
        for subject in subjects:
            rules = rules_of(self._policy, subject)
            for part in rule_lists.part_lists(rules, kind, permission):
                outcome = rule_lists.find_permitted(kind, rule_lists.allow_only(name), negate(part))
                if isinstance(outcome, Equal):
                    continue
                if not isinstance(outcome, Witness):
                    return f"the answer for {subject} is unknown: {outcome.reason}", None
                denying = rule_lists.matching_rule(rules, Effect.DENY, kind, permission, outcome.word)
                why = "a DENY rule matches" if denying else "no rule allows it"
                shown = rule_lists.display_name(kind, outcome.word)
                return f"{subject} may not {permission} {shown}: {why}", denying.origin if denying else None
        return "", None

    def _check_deny(self, within: Glob, kind: str, permission: str, name: Glob) -> tuple[str, Origin | None]:
        """Check that no possible subject has a permission on any of the names."""
        for each in who_can(self._policy, within, kind, permission, name):
            if each.unknown:
                return f"the answer for {each.subject or f'subjects like {each.like}'} is unknown: {each.unknown}", None
            return f"{each.subject} may {permission} {rule_lists.display_name(kind, each.word)}", each.where
        return "", None

    def _exercised(self, expected: Expectation, within: Glob, kind: str, permission: str, name: Glob) -> Iterator[Spot]:
        """Yield the spots of the rules that decide on subjects and objects of an expectation."""
        effect = Effect.ALLOW if expected.allowed else Effect.DENY
        names = [*rule_lists.part_patterns(kind, permission, name)]
        for subject, rules in self._rules.items():
            if not matches(within, subject):
                continue
            for rule in rules:
                if rule.effect is effect and any(
                    not disjoint(one, other) for key, other in names for one in rule_lists.object_patterns(rule, key)
                ):
                    yield rule.origin.spot


def _matches_nothing(message: str, expression: str, expected: Expectation) -> KeymintError:
    help_ = "" if expression.startswith(("/", "*")) else f"write {'/' + expression!r}"
    return KeymintError(message, where=expected.where, help=help_, code="expectation")


def diagnostics(results: Sequence[ExpectationResult]) -> Iterator[Diagnostic]:
    """Yield an error for each failed expectation, and a warning for each doubtful one."""
    for each in results:
        where, test = each.expectation.where, each.expectation.test
        if each.failure:
            rule = f"the rule is at {each.rule.alone()}" if each.rule else ""
            expected = "allowed" if each.expectation.allowed else "denied"
            message = f"{test}: expected to be {expected}, but {each.failure}"
            yield Diagnostic.error("expectation-failed", message, where, rule)
        if each.doubt:
            yield Diagnostic.warning("expectation-subject", f"{test}: {each.doubt}", where)
