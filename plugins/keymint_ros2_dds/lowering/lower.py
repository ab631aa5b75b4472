"""From the intermediate representation to DDS: which patterns of topic names each rule is about.

The result says, for each action, what is allowed and what is denied, with the rule that says so. It does not yet
say in which order: deny overrides allow.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from comarmor.errors import Diagnostic, Severity
from comarmor.patterns import glob
from comarmor.patterns.glob import Glob
from comarmor.patterns.printing import exact
from comarmor.patterns.ros_names import advice, is_possible
from comarmor.patterns.tokens import PatternError
from comarmor.rules import Effect, parts
from comarmor.text import did_you_mean
from keymint.errors import KeymintError
from keymint.ir import Rule, SubjectRules
from keymint_ros2_dds.lowering.mapping import IMAGES, Action, images, knows

Partitions = tuple[str, ...]
"""Partition expressions as a policy has them, sorted; empty: not narrowed."""
Side = Mapping[tuple[Glob, Partitions], Rule]
"""Patterns with their partitions, and the rule that first says something of them."""

RAW = "topic"
"""The kind of rules on DDS topics by their own names."""


@dataclass(frozen=True, slots=True)
class Lowered:
    """The rules of a subject on the level of DDS, by action."""

    allow: Mapping[Action, Side]
    deny: Mapping[Action, Side]
    diagnostics: tuple[Diagnostic, ...]


def lower(rules: SubjectRules, distro: str) -> Lowered:
    """Return what the rules of a subject say of DDS topics.

    Args:
        rules: the rules.
        distro: ROS 2 distribution whose mapping of names applies.

    Raises:
        KeymintError: an expression cannot be read, or the distribution has no such entities; says at which
            ``file:line``.
    """
    if unknown := [_unknown(rule, distro, rules.subject) for rule in rules.rules if not knows(distro, rule.kind)]:
        raise KeymintError.of(unknown)
    sides: dict[Effect, dict[Action, dict[tuple[Glob, Partitions], Rule]]] = {
        effect: {action: {} for action in Action} for effect in Effect
    }
    diagnostics: list[Diagnostic] = []
    for rule in rules.rules:
        side = sides[rule.effect]
        partitions = tuple(sorted(set(rule.partitions)))
        for expression in partitions:
            _parse(expression, rule)
        for expression in rule.expressions:
            found = False
            for action, pattern, partition in _images(expression, rule, distro):
                side[action].setdefault((pattern, partition or partitions), rule)
                found = True
            if not found or not (rule.kind == RAW or is_possible(_parse(expression, rule))):
                diagnostics.append(_never(expression, rule, rules.subject))
    return Lowered(sides[Effect.ALLOW], sides[Effect.DENY], tuple(diagnostics))


def _images(expression: str, rule: Rule, distro: str) -> list[tuple[Action, Glob, Partitions]]:
    """Return the DDS patterns of one expression of a rule, for all its permissions, and partitions from the mapping."""
    tokens = _parse(expression, rule)
    found: list[tuple[Action, Glob, Partitions]] = []
    for permission in rule.permissions:
        for _, part, suffix in parts(rule.kind, permission):
            if part not in IMAGES:
                raise KeymintError(
                    f"DDS knows no permission {part!r} of a {rule.kind} rule",
                    where=rule.origin,
                    help=did_you_mean(part, IMAGES),
                    code="permission-unknown",
                )
            for mapped in IMAGES[part]:
                for pattern, partition in images(distro, tokens, mapped, suffix, rule.effect):
                    if pattern and not glob.is_empty(pattern) and not (partition and glob.is_empty(partition)):
                        listed = () if partition is None else (exact(partition),)
                        found.append((mapped.action, pattern, listed))
    return found


def _parse(expression: str, rule: Rule) -> Glob:
    try:
        return glob.parse(expression)
    except PatternError as error:
        diagnostic = error.diagnostics[0]
        raise KeymintError(diagnostic.message, where=rule.origin, help=diagnostic.help, code="expression") from None


def _unknown(rule: Rule, distro: str, subject: str) -> Diagnostic:
    return Diagnostic(
        "distro-kind",
        Severity.ERROR,
        f"ROS 2 {distro.capitalize()} has no actions, but this is an {rule.effect} {rule.kind} rule",
        rule.origin,
        "remove it, or take a later distro",
        subject,
    )


def _never(expression: str, rule: Rule, subject: str) -> Diagnostic:
    raw = rule.kind == RAW
    return Diagnostic(
        "never-matches",
        Severity.WARNING,
        f"the expression {expression!r} of this {rule.effect} {rule.kind} rule matches no name: no "
        + ("DDS topic" if raw else "ROS object")
        + " can have such a name",
        rule.origin,
        "remove it" if raw or not expression else advice(expression),
        subject,
    )
