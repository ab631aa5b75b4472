# SPDX-License-Identifier: Apache-2.0
"""Compiles the rules of a subject to the rules of a grant, in the plain form and in smaller equivalent forms."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress

from comarmor.patterns.expression import exact
from comarmor.patterns.glob import Glob, sort_key
from comarmor.patterns.relations import disjoint
from comarmor.patterns.steps import StepLimitError, step_limit
from comarmor.rules import Effect
from comarmor.values import Data, field, replace
from keymint.api import BuildOptions, Grant, Hint, lazy
from keymint.errors import Diagnostic, KeymintError, Severity
from keymint.ir import Rule
from keymint_ros2_dds.compiling.rewriting import GUARD, EndpointCounts, gathered_rules, prioritised_rules
from keymint_ros2_dds.compiling.rule_order import portable_rules, rule_per_policy_rule, standard_rules
from keymint_ros2_dds.lowering.lowered_rules import GrantRule, Lowered, lower
from keymint_ros2_dds.lowering.name_mapping import TOPIC_ACTIONS, TopicAction, check_distro, has_kind
from keymint_ros2_dds.lowering.portable_expressions import (
    NotPortableError,
    UnportableError,
    portable_expressions,
    unsafe,
)

_endpoints = lazy("keymint_ros2_dds.lowering.endpoints:endpoints")
STEPS = 4_000_000
"""Steps that ordering the rules of a subject may take (:mod:`comarmor.patterns.steps`)."""


class Compiled(Data):
    """The rules of a grant.

    Attributes:
        forms: equivalent rules, the preferred form first: minimal, gathered, and in order of priority.
        plain: the plain form: a rule for each rule of the policy, with all its patterns.
        lowered: the rules of the policy as DDS patterns.
        portable: every vendor decides as the standard does.
        diagnostics: warnings and notes.
    """

    forms: tuple[tuple[GrantRule[str], ...], ...]
    plain: tuple[GrantRule[str], ...]
    lowered: Lowered
    portable: bool
    diagnostics: tuple[Diagnostic, ...]


def compile_rules(permissions: Grant, distro: str, options: BuildOptions) -> Compiled:
    """Compile the rules of a subject to rules that every vendor reads in the same way.

    Args:
        permissions: the permissions of the package.
        distro: ROS 2 distribution whose name mapping applies.
        options: ``allow_vendor_specific``: where vendors differ, follow the standard and warn; ``hints``: put what is
            requested more often first.

    Raises:
        KeymintError: a rule cannot be expressed portably; each such rule with its ``file:line``.
    """
    check_distro(distro)
    lowered = lower(permissions.rules, distro)
    report = _PortabilityReport(lowered, permissions.rules.subject, options.allow_vendor_specific)
    for action in TOPIC_ACTIONS:
        for pattern, reason in unsafe(lowered.allow[action]):
            report.add("portability-partition", action, pattern, reason)
    minimal = report.with_expressions(_minimal_rules(lowered, report))
    if report.diagnostics and not options.allow_vendor_specific:
        raise KeymintError.of(report.diagnostics)
    plain = _plain(lowered, report) if minimal else ()
    rewritten = prioritised_rules(gathered_rules(minimal), _endpoint_counts(options.hints, distro))
    forms = (rewritten, minimal) if rewritten != minimal else (minimal,)
    return Compiled(forms, plain, lowered, not report.diagnostics, (*lowered.diagnostics, *report.diagnostics))


def _minimal_rules(lowered: Lowered, report: _PortabilityReport) -> tuple[GrantRule[Glob], ...]:
    if report.diagnostics:
        return standard_rules(lowered)
    try:
        with step_limit(STEPS):
            return portable_rules(lowered)
    except UnportableError as error:
        report.add(error.code, None, error.pattern, error.reason)
    except StepLimitError as error:
        reason = f"it overlaps with others in too many ways: no order of the rules in {error.steps:,} steps"
        # The pattern with the most wildcards is likely the hardest to order.
        patterns = (pattern for _, _, pattern, _ in lowered.patterns())
        hard = min(patterns, key=lambda each: (-sum(not isinstance(token, str) for token in each), sort_key(each)))
        report.add("portability-effort", None, hard, reason)
    return standard_rules(lowered)


def _plain(lowered: Lowered, report: _PortabilityReport) -> tuple[GrantRule[str], ...]:
    """Return the rules with all their patterns; without redundant ones if all cannot be ordered or are not portable."""
    if report.diagnostics:
        return report.with_expressions(rule_per_policy_rule(standard_rules(lowered), lowered))
    full = replace(report)  # without diagnostics
    with suppress(UnportableError, StepLimitError), step_limit(STEPS):
        rules = full.with_expressions(rule_per_policy_rule(portable_rules(lowered, reduced=False), lowered))
        if rules and not full.diagnostics:
            return rules
    return report.with_expressions(rule_per_policy_rule(portable_rules(lowered), lowered))


def _endpoint_counts(hints: Iterable[Hint], distro: str) -> EndpointCounts:
    counts: Counter[tuple[str, str, str]] = Counter()
    for each in hints:
        if not has_kind(distro, each.edge.object.kind):
            continue  # no subject can request it in this distribution
        for endpoint in _endpoints(distro, each.edge):
            for partition in endpoint.object.partitions or ("",):
                counts[endpoint.permission, endpoint.object.name, partition] += each.times
    return counts


class _PortabilityReport(Data, frozen=False):
    """Collects the rules that vendors read differently: each reason once for each rule of the policy."""

    lowered: Lowered
    subject: str
    warn: bool
    _found: dict[tuple[str, Rule | None, str], Diagnostic] = field(default_factory=dict, init=False)

    @property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        return tuple(self._found.values())

    def add(self, code: str, action: TopicAction | None, pattern: Glob, reason: str) -> None:
        rule = self._rule(action, pattern)
        where = rule.origin if rule else None
        prefix = (
            f"this {rule.effect} {rule.kind} rule cannot be expressed portably across DDS vendors: " if rule else ""
        )
        if self.warn:
            severity = Severity.WARNING
            message = f"{prefix}{reason}; the document follows the standard, Cyclone DDS and Fast DDS may differ"
            hint = "check which names are affected before you rely on it"
        else:
            severity, message = Severity.ERROR, prefix + reason
            hint = "write the names out, or build with --allow-vendor-specific"
        diagnostic = Diagnostic(code, severity, message, where, hint, self.subject)
        self._found.setdefault((code, rule, reason), diagnostic)

    def with_expressions(self, rules: Iterable[GrantRule[Glob]]) -> tuple[GrantRule[str], ...]:
        """Return rules with expressions in place of patterns."""
        return tuple(GrantRule(rule.effect, rule.partitions, dict(self._expressions(rule))) for rule in rules)

    def _expressions(self, rule: GrantRule[Glob]) -> Iterator[tuple[TopicAction, tuple[str, ...]]]:
        """Yield the sorted expressions of a rule by action."""
        for action in TOPIC_ACTIONS:
            if action not in rule.topics:
                continue
            texts: set[str] = set()
            for pattern in rule.topics[action]:
                try:
                    texts.update(portable_expressions(pattern))
                except NotPortableError as error:
                    self.add("portability-expression", action, pattern, str(error))
                    texts.add(exact(pattern))
            if texts:
                yield action, tuple(sorted(texts))

    def _rule(self, action: TopicAction | None, pattern: Glob) -> Rule | None:
        """Return the policy rule that has a pattern, or else one that overlaps it; denials first."""
        patterns = sorted(self.lowered.patterns(), key=lambda item: item[0] is Effect.ALLOW)
        candidates = [(other, rule) for _, at, other, rule in patterns if action in {None, at}]
        exact = (rule for other, rule in candidates if other == pattern)
        overlapping = (rule for other, rule in candidates if not disjoint(other, pattern))
        return next(exact, None) or next(overlapping, None)


def vendor_notes(rules: Sequence[GrantRule[str]], permissions: Grant) -> Iterator[Diagnostic]:
    """Yield notes on what only some vendors do differently with the rules, once for a package."""
    subject, where = permissions.rules.subject, permissions.origin
    if not rules:
        message = f"{subject} is allowed nothing, so it may not join a domain either"
        yield Diagnostic.note("no-permissions", message, where, "allow something if it is to take part", subject)
    if any("relay" in rule.topics for rule in rules):
        message = "Cyclone DDS and OpenDDS ignore permissions to relay"
        yield Diagnostic.warning("vendor-relay", message, where, "do not rely on them there", subject)
    expressions = {text for rule in rules for text in rule.every_topic()}
    infix = sorted(text for text in expressions - {GUARD} if "*" in text[:-1] or "[" in text)
    if infix:
        option = "; --no-optimise writes out the names that share an expression" if GUARD in expressions else ""
        message = (
            f"OpenDDS and RTI Connext may not match a '*' before the end of an expression, or a bracket expression "
            f"({len(infix)} here, e.g. {infix[0]!r})"
        )
        yield Diagnostic.note("vendor-wildcard", message, where, f"Cyclone DDS and Fast DDS do{option}", subject)
