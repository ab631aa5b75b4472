# SPDX-License-Identifier: Apache-2.0
"""Compile the rules of a subject to the rules of a router's access control, and say what Zenoh cannot express of them.

First they become rules for permissions that are not composite (:class:`NameRules`), then rules of the router. Order has
no meaning: a denial overrides. What no rule allows is denied by the default of the configuration.

A denial holds for literal keys only: a router denies what a denial includes. A message may have a key expression in
place of a key: ``0/*/x/…`` meets the denied ``0/secret/x/…`` without being included in it. Nodes send literal keys
only; a hostile session need not. Its message reaches a receiver of the denied name if this may receive such key
expressions too. :func:`deny_wildcards` warns about it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from itertools import chain

from comarmor.patterns import glob
from comarmor.patterns.glob import Glob
from comarmor.patterns.possible_names import advice, matches_ros_name
from comarmor.patterns.relations import TooComplexError, disjoint, intersection
from comarmor.patterns.tokens import PatternError
from comarmor.rules import Effect, parts
from comarmor.text import did_you_mean
from comarmor.values import Data
from keymint.api import DomainRange, Package
from keymint.errors import Defects, Diagnostic, KeymintError, Severity, require_none
from keymint.ir import Rule, SubjectRules
from keymint_ros2_zenoh import keyexpr
from keymint_ros2_zenoh.documents.configuration import AclRule, Flow, Message, Permission
from keymint_ros2_zenoh.keyexpr import KeyExpr, TooManyAlternativesError, key_exprs
from keymint_ros2_zenoh.lowering import permissions

DDS_INFRASTRUCTURE = "ros_discovery_info"
"""The DDS topic by which the nodes of DDS middleware describe themselves; the policy library allows it to every node.

An ALLOW rule on exactly this raw topic grants no right that Zenoh has. The tokens of the graph serve the same purpose,
and every enclave is permitted its own tokens.
"""

_DROPPED = "zenoh-infrastructure"
_Problem = tuple[str, Severity, str, str]
"""The code and severity of a finding on a rule, its message, and what to do about it."""


class NameRule(Data):
    """A pattern of a rule for one permission.

    Attributes:
        effect: allow or deny.
        permission: a key of :data:`permissions.SLOTS`.
        pattern: pattern of names of topics or services that matches at least one legal ROS name.
        rule: the rule of the policy.
    """

    effect: Effect
    permission: str
    pattern: Glob
    rule: Rule


class NameRules(Data):
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
    permissions.check_distro(distro)
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
    require_none(each for each in diagnostics if each.severity is Severity.ERROR)
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
            if part not in permissions.SLOTS:
                message = f"Zenoh knows no permission {part!r} of a {rule.kind} rule"
                yield "permission-unknown", Severity.ERROR, message, did_you_mean(part, permissions.SLOTS)


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
            if keyexpr.intersects(key, denied) and not keyexpr.includes(denied, key):
                return key, allowing
    return None


MAX_DOMAINS = 32
"""Domains that one subject may have: key expressions have no ranges, so that each domain repeats all of them."""


def lower_package(package: Package) -> tuple[tuple[AclRule, ...], tuple[Diagnostic, ...]]:
    """Return what a router must permit or deny on the link of a package's subject, as rules without an id, and notes.

    Flows are as the router sees them: ingress is from the subject, egress to it.

    Raises:
        KeymintError: Zenoh cannot express a rule or the validity of the grant, or there are too many domains; all
            defects with their ``file:line``.
    """
    defects, grant = Defects(), package.grant
    rights, identity = grant.validity, package.identity.validity
    if rights is not None and (rights.not_before > identity.not_before or rights.not_after < identity.not_after):
        defects.found.append(
            Diagnostic.error(
                "zenoh-validity",
                "the permissions are valid for a shorter time than the certificate, but rights on Zenoh have no dates: "
                "they end with the certificate",
                grant.origin,
                "give the certificate the same validity, or leave out that of the permissions",
                package.subject,
            )
        )
    with defects:
        names = name_rules(grant.rules, package.distro)
        if sum(each.last - each.first + 1 for each in grant.domains) > MAX_DOMAINS:
            why = "Zenoh has no ranges of them, so that each one repeats all rules"
            message = f"the subject may join more than {MAX_DOMAINS} domains: {why}"
            where, help_ = grant.domains_origin or grant.origin, "name the domains that it needs"
            raise KeymintError(message, where=where, help=help_, code="zenoh-domains")
    defects.require_none()
    ids = domain_ids(grant.domains)
    return (*_rules(names, ids), *_graph(names.subject, ids)), tuple(lower_notes(names))


def domain_ids(domains: Iterable[DomainRange]) -> tuple[int, ...]:
    """Return the ids of all domains."""
    return tuple(sorted({each for item in domains for each in range(item.first, item.last + 1)}))


def _rules(names: NameRules, domains: tuple[int, ...]) -> Iterator[AclRule]:
    """Yield the rules for names, in the order of the policy."""
    places: dict[tuple[Effect, Rule], dict[tuple[KeyExpr, permissions.Place], set[permissions.Slot]]] = {}
    for effect, slots, pattern, rule in slot_rules(names):
        by_key = places.setdefault((effect, rule), {})
        for key in key_exprs(pattern):
            for slot in slots:
                by_key.setdefault((key, slot.place), set()).add(slot)
    for (effect, _), by_key in places.items():
        groups: dict[frozenset[tuple[Message, Flow]], list[KeyExpr]] = {}
        for (name, place), own in by_key.items():
            sides = frozenset((slot.message, slot.flow) for slot in own)
            for domain in domains:
                groups.setdefault(sides, []).append(permissions.name_key(domain, name, place))
        for sides, keys in groups.items():
            yield from _by_flow(effect, sides, keys)


def slot_rules(names: NameRules) -> Iterator[tuple[Effect, tuple[permissions.Slot, ...], Glob, Rule]]:
    """Yield patterns of names with the slots that they allow or deny, and the rule that they come from.

    An ALLOW rule allows what its permission needs. A DENY rule denies all messages in both flows, except what a
    permission that it does not deny needs, and that an ALLOW rule may grant on one of its names.
    """
    denied: dict[tuple[Rule, Glob], set[str]] = {}
    for each in names.rules:
        if each.effect is Effect.ALLOW:
            yield Effect.ALLOW, permissions.SLOTS[each.permission], each.pattern, each.rule
        else:
            denied.setdefault((each.rule, each.pattern), set()).add(each.permission)
    for (rule, pattern), own in denied.items():
        living = {
            permission
            for permission in permissions.SLOTS
            if permission not in own
            and any(not disjoint(allowed, pattern) for allowed in names.patterns(Effect.ALLOW, permission))
        }
        yield Effect.DENY, tuple(slot for slot, users in permissions.USERS.items() if not users & living), pattern, rule
        for slot, users in permissions.USERS.items():
            if users & own:
                for both in _denied_too(names, pattern, users & living):
                    yield Effect.DENY, (slot,), both, rule


def _denied_too(names: NameRules, pattern: Glob, others: Iterable[str]) -> Iterator[Glob]:
    """Yield the patterns of the names that a pattern matches and that are denied for other permissions as well."""
    for permission in sorted(others):
        for other in names.patterns(Effect.DENY, permission):
            with suppress(TooComplexError, TooManyAlternativesError):  # see SLOTS: a reply alone is no right
                for both in intersection(pattern, other):
                    key_exprs(both)
                    yield both


def _by_flow(effect: Effect, sides: Iterable[tuple[Message, Flow]], keys: Iterable[KeyExpr]) -> Iterator[AclRule]:
    """Yield rules of messages and flows, one if both flows have the same messages."""
    expressions = tuple(str(key) for key in sorted(set(keys)))
    permission = Permission.ALLOW if effect is Effect.ALLOW else Permission.DENY
    flows: dict[tuple[Message, ...], tuple[Flow, ...]] = {}
    for flow in Flow:
        messages = tuple(message for message in Message if (message, flow) in sides)
        flows[messages] = (*flows.get(messages, ()), flow)
    for messages, own in flows.items():
        if messages:
            yield AclRule("", messages, own, permission, expressions)


def _graph(subject: str, domains: tuple[int, ...]) -> Iterator[AclRule]:
    """Yield what lets a node announce itself and read the graph. No enclave can announce the nodes of another one."""
    own = [permissions.own_tokens_key(domain, subject) for domain in domains]
    yield from _by_flow(Effect.ALLOW, {(Message.LIVELINESS_TOKEN, Flow.INGRESS)}, own)
    yield from _by_flow(Effect.ALLOW, permissions.GRAPH_SLOTS, [permissions.graph_key(domain) for domain in domains])


def combined_rules(rules: Iterable[AclRule]) -> tuple[AclRule, ...]:
    """Return fewer rules that decide every message and key expression as the given ones do.

    The order of rules has no meaning, and a rule applies if one of its key expressions includes the key. So rules of
    the same effect, messages and flows are one rule with all their key expressions. One that another includes is left
    out.
    """
    groups: dict[tuple[tuple[Message, ...], tuple[Flow, ...], Permission], set[KeyExpr]] = {}
    for rule in rules:
        groups.setdefault((rule.messages, rule.flows, rule.permission), set()).update(
            map(keyexpr.parse, rule.key_exprs)
        )
    return tuple(AclRule("", *shared, tuple(map(str, keyexpr.maximal(keys)))) for shared, keys in groups.items())
