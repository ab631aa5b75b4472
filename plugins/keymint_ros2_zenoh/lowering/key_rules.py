# SPDX-License-Identifier: Apache-2.0
"""Compile the rules of a subject to the rules of a router's access control.

Order has no meaning: a denial overrides. What no rule allows is denied by the default of the configuration.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress

from comarmor.errors import Defects, Diagnostic, Origin
from comarmor.patterns.glob import Glob
from comarmor.patterns.relations import TooComplexError, disjoint, intersection
from comarmor.rules import Effect
from keymint.api import DomainRange, Package
from keymint.errors import KeymintError
from keymint.ir import Rule, SubjectRules
from keymint_ros2_zenoh.documents.configuration import AclRule, Flow, Message, Permission
from keymint_ros2_zenoh.keyexpr import KeyExpr, TooManyAlternativesError, key_exprs, maximal, parse
from keymint_ros2_zenoh.lowering import permissions
from keymint_ros2_zenoh.lowering.name_rules import NameRules, lower_notes, name_rules

MAX_DOMAINS = 32
"""Domains that one subject may have: key expressions have no ranges, so that each domain repeats all of them."""


def lower(
    rules: SubjectRules, distro: str, domains: Sequence[DomainRange], origin: Origin
) -> tuple[tuple[AclRule, ...], tuple[Diagnostic, ...]]:
    """Return what a router must permit or deny on the link of a subject, as rules without an id, and diagnostics.

    Flows are as the router sees them: ingress is from the subject, egress to it.

    Args:
        rules: the subject's rules.
        distro: ROS 2 distribution.
        domains: the domains in which they apply.
        origin: where the domains are written.

    Raises:
        KeymintError: Zenoh cannot express a rule, or there are too many domains.
    """
    names = name_rules(rules, distro)
    if sum(each.last - each.first + 1 for each in domains) > MAX_DOMAINS:
        raise KeymintError(
            f"the subject may join more than {MAX_DOMAINS} domains: Zenoh has no ranges of them, so that each one "
            "repeats all rules",
            where=origin,
            help="name the domains that it needs",
            code="zenoh-domains",
        )
    ids = domain_ids(domains)
    return (*_rules(names, ids), *_graph(rules.subject, ids)), tuple(lower_notes(names))


def lower_package(package: Package) -> tuple[tuple[AclRule, ...], tuple[Diagnostic, ...]]:
    """Return what a router must permit or deny on the link of a package's subject; see :func:`lower`.

    Raises:
        KeymintError: Zenoh cannot express a rule or the validity of the grant; all defects with their ``file:line``.
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
        lowered = lower(grant.rules, package.distro, grant.domains, grant.domains_origin or grant.origin)
    defects.require_none()
    return lowered


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
    for each in names.rules:
        if each.effect is Effect.ALLOW:
            yield Effect.ALLOW, permissions.SLOTS[each.permission], each.pattern, each.rule
    denied: dict[tuple[Rule, Glob], set[str]] = {}
    for each in names.rules:
        if each.effect is Effect.DENY:
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
        groups.setdefault((rule.messages, rule.flows, rule.permission), set()).update(map(parse, rule.key_exprs))
    return tuple(AclRule("", *shared, tuple(map(str, maximal(keys)))) for shared, keys in groups.items())
