"""Unit tests of a policy: whether what is expected holds, and which rules no expectation is about."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from comarmor.errors import Diagnostic, Origin, Severity, Spot
from comarmor.patterns.decision_lists import Block, Equal, Witness
from comarmor.patterns.glob import EVERYTHING, Glob, literal, parse, surround
from comarmor.patterns.matching import matches
from comarmor.patterns.relations import disjoint
from comarmor.rules import Effect, parts
from keymint.analysis.query import parse_permission
from keymint.analysis.rule_lists import allowed, asked, keys, meet, part_lists, patterns, word
from keymint.analysis.subject_patterns import can_exist, matching, pattern_examples, rules_of, unknown_subject
from keymint.analysis.who_can import who_can
from keymint.api import Expectation, LoadedPolicy
from keymint.errors import KeymintError
from keymint.ir import Rule

Place = Spot


@dataclass(frozen=True, slots=True)
class ExpectationResult:
    """An expectation that was checked.

    Attributes:
        expectation: the expectation.
        failure: why it does not hold, on one line; empty if it holds.
        rule: the rule that breaks it, if one does.
        doubt: why it may not say what was meant; empty if there is no doubt.
        exercised: places of the rules that it is about.
    """

    expectation: Expectation
    failure: str
    rule: Origin | None
    doubt: str
    exercised: frozenset[Place]


class ExpectationChecker:
    """Checks expectations.

    Args:
        policy: the policy.
    """

    def __init__(self, policy: LoadedPolicy) -> None:
        self._policy = policy
        self._named = policy.subjects()
        self._rules: Mapping[str, tuple[Rule, ...]] = {
            subject: rules_of(policy, subject) for subject in (*self._named, *pattern_examples(policy))
        }

    def rules(self) -> dict[Place, Rule]:
        """Return the rules that apply to any subject, by place."""
        return {rule.origin.spot: rule for rules in self._rules.values() for rule in rules}

    def check(self, expected: Expectation) -> ExpectationResult:
        """Return whether an expectation holds.

        Raises:
            KeymintError: it names no permission, or something that no subject or object can be named.
        """
        try:
            kind, permission = parse_permission(expected.permission, expected.object)
        except KeymintError as error:
            raise KeymintError.of(replace(each, where=expected.where) for each in error.diagnostics) from None
        within = parse(expected.subject)
        if not can_exist(within):
            raise KeymintError(
                f"no subject can be named as {expected.subject!r} says",
                where=expected.where,
                help=f"write {'/' + expected.subject!r}" if expected.subject[:1] not in ("/", "*") else "",
                code="expectation",
            )
        name = asked(kind, expected.object, expected.partition)
        if isinstance(meet(kind, allowed(name)), Equal):
            raise KeymintError(
                f"no object can be named as {expected.object!r} says, so that the expectation always holds",
                where=expected.where,
                help=f"write {'/' + expected.object!r}" if expected.object[:1] not in ("/", "*") else "",
                code="expectation",
            )
        failed = self._allow if expected.allowed else self._deny
        failure, rule = failed(within, kind, permission, name)
        exercised = frozenset(self._exercised(expected, within, kind, permission, name))
        return ExpectationResult(expected, failure, rule, unknown_subject(self._policy, within), exercised)

    def _allow(self, within: Glob, kind: str, permission: str, name: Glob) -> tuple[str, Origin | None]:
        """Check that all subjects that the policy names, of those in question, hold a permission on all names."""
        exact = literal(within)
        subjects = (exact,) if exact is not None else matching(self._policy, within)
        if not subjects:
            return "the policy names no subject that it is about", None
        for subject in subjects:
            rules = rules_of(self._policy, subject)
            for part in part_lists(rules, kind, permission):
                refused = (*(Block(not block.allows, block.patterns) for block in part), Block(True, (EVERYTHING,)))
                outcome = meet(kind, allowed(name), refused)
                if isinstance(outcome, Equal):
                    continue
                if not isinstance(outcome, Witness):
                    return f"it was not decided for {subject}: {outcome.reason}", None
                denying = self._denying(rules, kind, permission, outcome.word)
                why = "a DENY rule matches" if denying else "no rule allows it"
                shown = word(kind, outcome.word)
                return f"{subject} may not {permission} {shown}: {why}", denying.origin if denying else None
        return "", None

    def _deny(self, within: Glob, kind: str, permission: str, name: Glob) -> tuple[str, Origin | None]:
        """Check that no subject there is holds a permission on any of the names."""
        for each in who_can(self._policy, within, kind, permission, name):
            if each.unknown:
                return f"it was not decided for {each.subject or f'subjects like {each.like}'}: {each.unknown}", None
            return f"{each.subject} may {permission} {word(kind, each.word)}", each.where
        return "", None

    def _denying(self, rules: Sequence[Rule], kind: str, permission: str, found: str) -> Rule | None:
        for part_kind, part, suffix in parts(kind, permission):
            for rule in rules:
                if rule.effect is Effect.DENY and any(
                    matches(one, found + suffix)
                    for expression in rule.expressions
                    for one in patterns(rule, expression, (part_kind, part))
                ):
                    return rule
        return None

    def _exercised(
        self, expected: Expectation, within: Glob, kind: str, permission: str, name: Glob
    ) -> Iterator[Place]:
        """Yield the places of the rules that decide what an expectation is about."""
        effect = Effect.ALLOW if expected.allowed else Effect.DENY
        wanted = [
            ((part_kind, part), surround("", name, suffix)) for part_kind, part, suffix in parts(kind, permission)
        ]
        for subject, rules in self._rules.items():
            if not matches(within, subject):
                continue
            for rule in rules:
                if rule.effect is effect and any(
                    not disjoint(one, about)
                    for key, about in wanted
                    if key in keys(rule)
                    for expression in rule.expressions
                    for one in patterns(rule, expression, key)
                ):
                    yield rule.origin.spot


def diagnostics(found: Sequence[ExpectationResult]) -> Iterator[Diagnostic]:
    """Yield what is to be said of expectations: those that do not hold, and those that are in doubt."""
    for each in found:
        where, test = each.expectation.where, each.expectation.test
        if each.failure:
            rule = f"the rule is at {each.rule.alone()}" if each.rule else ""
            wanted = "allowed" if each.expectation.allowed else "denied"
            message = f"{test}: expected to be {wanted}, but {each.failure}"
            yield Diagnostic("expectation-failed", Severity.ERROR, message, where, rule)
        if each.doubt:
            yield Diagnostic("expectation-subject", Severity.WARNING, f"{test}: {each.doubt}", where)
