# SPDX-License-Identifier: Apache-2.0
"""The rules of a subject by permissions that are not composite, and what Zenoh cannot express of them."""

from __future__ import annotations

from collections.abc import Iterator

from comarmor.errors import Diagnostic, Severity
from comarmor.patterns import glob
from comarmor.patterns.glob import Glob
from comarmor.patterns.possible_names import advice, matches_ros_name
from comarmor.patterns.tokens import PatternError
from comarmor.rules import Effect, parts
from comarmor.text import did_you_mean
from comarmor.values import dataclass
from keymint.errors import KeymintError
from keymint.ir import Rule, SubjectRules
from keymint_ros2_zenoh.keyexpr.key_expansion import TooManyAlternativesError, key_exprs
from keymint_ros2_zenoh.lowering.message_slots import SLOTS
from keymint_ros2_zenoh.lowering.name_keys import check_distro

KINDS = ("ros_topic", "ros_service", "ros_action", "ros_parameter")
"""Kinds of rules that Zenoh can express."""
DDS_INFRASTRUCTURE = "ros_discovery_info"
"""The DDS topic by which the nodes of DDS middleware describe themselves; the policy library allows it to every node.

An ALLOW rule on exactly this raw topic grants no right that Zenoh has. The tokens of the graph serve the same purpose,
and every enclave is permitted its own tokens.
"""

_DROPPED = "zenoh-infrastructure"
_Problem = tuple[str, Severity, str, str]
"""The code and severity of a finding on a rule, its message, and what to do about it."""


@dataclass(frozen=True, slots=True)
class NameRule:
    """A pattern of a rule for one permission.

    Attributes:
        effect: allow or deny.
        permission: a key of :data:`SLOTS`.
        pattern: pattern of names of topics or services that matches at least one legal ROS name.
        rule: the rule of the policy.
    """

    effect: Effect
    permission: str
    pattern: Glob
    rule: Rule


@dataclass(frozen=True, slots=True)
class NameRules:
    """The rules of a subject that Zenoh expresses, and warnings and notes about the others."""

    subject: str
    rules: tuple[NameRule, ...]
    diagnostics: tuple[Diagnostic, ...]

    def patterns(self, effect: Effect, permission: str) -> tuple[Glob, ...]:
        """Return the distinct patterns of an effect and a permission."""
        own = (each for each in self.rules if (each.effect, each.permission) == (effect, permission))
        return tuple(dict.fromkeys(each.pattern for each in own))


def name_rules(rules: SubjectRules, distro: str) -> NameRules:
    """Return the rules of a subject by permission.

    Args:
        rules: the rules.
        distro: ROS 2 distribution.

    Raises:
        KeymintError: Zenoh cannot express rules, all of which are reported; an expression is invalid; or the
            distribution has no rmw_zenoh.
    """
    check_distro(distro)
    found: dict[NameRule, None] = {}
    diagnostics: list[Diagnostic] = []
    for rule in rules.rules:
        if not is_dds_infrastructure(rule):
            for each in _examined(rule):
                if isinstance(each, NameRule):
                    found[each] = None
                else:
                    code, severity, message, help_ = each
                    diagnostics.append(Diagnostic(code, severity, message, rule.origin, help_, rules.subject))
        elif not any(each.code == _DROPPED for each in diagnostics):
            diagnostics.append(_dropped(rule, rules.subject))
    if errors := [each for each in diagnostics if each.severity is Severity.ERROR]:
        raise KeymintError.of(errors)
    return NameRules(rules.subject, tuple(found), tuple(diagnostics))


def is_dds_infrastructure(rule: Rule) -> bool:
    """Return whether a rule only allows nodes to describe themselves to each other on DDS."""
    return (
        rule.effect is Effect.ALLOW
        and rule.kind == "topic"
        and rule.expressions == (DDS_INFRASTRUCTURE,)
        and not rule.partitions
        and "relay" not in rule.permissions
    )


def _examined(rule: Rule) -> Iterator[NameRule | _Problem]:
    """Yield the rules that a rule is made of, and what Zenoh cannot express of it."""
    defects = list(_defects(rule))
    yield from defects
    if not defects:
        for expression in rule.expressions:
            yield from _of_expression(expression, rule)


def _of_expression(expression: str, rule: Rule) -> Iterator[NameRule | _Problem]:
    try:
        pattern = glob.parse(expression)
    except PatternError as error:
        first = error.diagnostics[0]
        yield "expression", Severity.ERROR, first.message, first.help
        return
    shown = f"the expression {expression!r} of this {rule.effect} {rule.kind} rule"
    try:
        for permission in rule.permissions:
            for _, part, suffix in parts(rule.kind, permission):
                own = glob.surround("", pattern, suffix)
                if key_exprs(own):
                    yield NameRule(rule.effect, part, own, rule)
    except TooManyAlternativesError as error:
        message = f"key expressions have no '?' and no brackets, and without them {shown} cannot be written: {error}"
        yield "zenoh-expression", Severity.ERROR, message, "write '*', or list the names"
        return
    if not matches_ros_name(pattern):
        message = f"{shown} matches no name: no ROS object can have such a name"
        yield "never-matches", Severity.WARNING, message, advice(expression) if expression else "remove it"


def _defects(rule: Rule) -> Iterator[_Problem]:
    """Yield what Zenoh cannot express of a rule, whatever its expressions."""
    this = f"this {rule.effect} {rule.kind} rule"
    if rule.kind not in KINDS:
        message = f"{this} names DDS topics by their own names, which Zenoh does not have"
        help_ = "write a rule of kind ros_topic or ros_service, or leave the rule to a policy for DDS"
        yield "zenoh-raw-topic", Severity.ERROR, message, help_
        return
    if rule.partitions:
        message = f"{this} names partitions, which Zenoh does not have"
        yield "zenoh-partition", Severity.ERROR, message, "remove them"
    for permission in rule.permissions:
        if permission.endswith("relay"):
            message = f"{this} is about relaying, which Zenoh has no right for"
            yield "zenoh-relay", Severity.ERROR, message, "control who may publish and subscribe instead"
            continue
        for _, part, _ in parts(rule.kind, permission):
            if part not in SLOTS:
                message = f"Zenoh knows no permission {part!r} of a {rule.kind} rule"
                yield "permission-unknown", Severity.ERROR, message, did_you_mean(part, SLOTS)


def _dropped(rule: Rule, subject: str) -> Diagnostic:
    # Without the files that include the rule: they differ from subject to subject, and all have one note together.
    where = rule.origin.alone()
    return Diagnostic.note(
        _DROPPED,
        f"the rule on {DDS_INFRASTRUCTURE}, which only DDS has, is left out: on Zenoh every enclave may announce its "
        "own nodes and read the graph",
        where,
        "",
        subject,
    )
