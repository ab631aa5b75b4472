# SPDX-License-Identifier: Apache-2.0
"""The rules of a subject by permissions that are not composite, and what Zenoh cannot express of them.

A denial holds for literal keys only: a router denies what a denial includes. A message may have a key expression in
place of a key: ``0/*/x/…`` meets the denied ``0/secret/x/…`` without being included in it. Nodes send literal keys
only; a hostile session need not. Its message reaches a receiver of the denied name if this may receive such key
expressions too. :func:`deny_wildcards` warns about it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import chain

from comarmor.errors import Diagnostic, Severity
from comarmor.patterns import glob
from comarmor.patterns.glob import Glob
from comarmor.patterns.possible_names import advice, matches_ros_name
from comarmor.patterns.relations import disjoint
from comarmor.patterns.tokens import PatternError
from comarmor.rules import Effect, parts
from comarmor.text import did_you_mean
from comarmor.values import dataclass
from keymint.errors import KeymintError
from keymint.ir import Rule, SubjectRules
from keymint_ros2_zenoh.keyexpr import KeyExpr, TooManyAlternativesError, includes, intersects, key_exprs
from keymint_ros2_zenoh.lowering.permissions import SLOTS, check_distro

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
            for each in list(_defects(rule)) or _examined(rule):
                if isinstance(each, NameRule):
                    found[each] = None
                else:
                    code, severity, message, help_ = each
                    diagnostics.append(Diagnostic(code, severity, message, rule.origin, help_, rules.subject))
        elif not any(each.code == _DROPPED for each in diagnostics):
            message = (
                f"the rule on {DDS_INFRASTRUCTURE}, which only DDS has, is left out: on Zenoh every enclave may "
                "announce its own nodes and read the graph"
            )
            # Without the files that include the rule: they differ by subject, and all subjects have one note together.
            diagnostics.append(Diagnostic.note(_DROPPED, message, rule.origin.alone(), "", rules.subject))
    if errors := [each for each in diagnostics if each.severity is Severity.ERROR]:
        raise KeymintError.of(errors)
    return NameRules(rules.subject, tuple(found), tuple(diagnostics))


def check_rules(rules: SubjectRules, distro: str) -> Sequence[Diagnostic]:
    """Return rules that Zenoh cannot express, that hold for literal keys only, or that match no name.

    Args:
        rules: the policy's rules for a subject.
        distro: ROS 2 distribution whose name mapping applies.
    """
    try:
        return tuple(lower_notes(name_rules(rules, distro)))
    except KeymintError as error:
        return error.diagnostics


def lower_notes(names: NameRules) -> Iterator[Diagnostic]:
    """Yield the warnings and notes about the rules of a subject."""
    yield from names.diagnostics
    yield from deny_wildcards(names)


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
    """Yield the rules that the expressions of a rule make, and what Zenoh cannot express of them."""
    for expression in rule.expressions:
        try:
            pattern = glob.parse(expression)
        except PatternError as error:
            first = error.diagnostics[0]
            yield "expression", Severity.ERROR, first.message, first.help
            continue
        shown = f"the expression {expression!r} of this {rule.effect} {rule.kind} rule"
        try:
            for _, part, suffix in chain.from_iterable(parts(rule.kind, each) for each in rule.permissions):
                own = glob.surround("", pattern, suffix)
                if key_exprs(own):
                    yield NameRule(rule.effect, part, own, rule)
        except TooManyAlternativesError as error:
            message = (
                f"key expressions have no '?' and no brackets, and without them {shown} cannot be written: {error}"
            )
            yield "zenoh-expression", Severity.ERROR, message, "write '*', or list the names"
            continue
        if not matches_ros_name(pattern):
            message = f"{shown} matches no name: no ROS object can have such a name"
            yield "never-matches", Severity.WARNING, message, advice(expression) if expression else "remove it"


def _defects(rule: Rule) -> Iterator[_Problem]:
    """Yield what Zenoh cannot express of a rule, whatever its expressions."""
    this = f"this {rule.effect} {rule.kind} rule"
    if rule.kind == "topic":
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


SENDING = ("ros_publish", "ros_call")
"""The permissions to send: what a subject may receive, its peers decide by what they may send."""
_ASKING = "ros_subscribe"
"""A late subscriber asks for cached data, and gets it if replies are not denied because it may call a service."""


def deny_wildcards(names: NameRules) -> Iterator[Diagnostic]:
    """Yield a warning for each DENY rule of a subject that an allowed key expression meets without being included."""
    reported, called = set(), names.patterns(Effect.ALLOW, "ros_call")
    for permission in (*SENDING, _ASKING):
        allowed = [each for each in names.rules if (each.effect, each.permission) == (Effect.ALLOW, permission)]
        wild = [(key, each) for each in allowed for key in key_exprs(each.pattern) if not key.is_literal]
        for denial in names.rules:
            if (denial.effect, denial.permission) != (Effect.DENY, permission) or denial.rule.origin in reported:
                continue
            # A reply about a denied name reaches the subject only if it may call a service of that name.
            if permission == _ASKING and all(disjoint(denial.pattern, each) for each in called):
                continue
            found = _met(denial, wild)
            if found:
                reported.add(denial.rule.origin)
                key, allowing = found
                message = (
                    f"this DENY {denial.rule.kind} rule holds for names only: the ALLOW rule at "
                    f"{allowing.rule.origin} also permits key expressions such as '<domain>/{key}/…', which cover a "
                    "denied name; a hostile process can send them, and they arrive where a receiver may receive them"
                )
                help_ = "allow the names that the subject needs instead of a wildcard"
                yield Diagnostic.warning("zenoh-deny-wildcard", message, denial.rule.origin, help_, names.subject)


def _met(denial: NameRule, wild: list[tuple[KeyExpr, NameRule]]) -> tuple[KeyExpr, NameRule] | None:
    """Return the first key expression that a denial meets and does not include, with its rule."""
    for denied in key_exprs(denial.pattern):
        for key, allowing in wild:
            if intersects(key, denied) and not includes(denied, key):
                return key, allowing
    return None
