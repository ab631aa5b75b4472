# SPDX-License-Identifier: Apache-2.0
"""The reference evaluator: decides one request by testing every rule. The index of rules is tested against it."""

from __future__ import annotations

from collections.abc import Sequence

from comarmor.errors import ComArmorError, Reason
from comarmor.language.syntax import Decision
from comarmor.patterns.expression import rule_matches, rule_matches_partition
from comarmor.rules import PARTS, PERMISSIONS, Effect, Rule
from comarmor.text import did_you_mean, quote


def decide(rules: Sequence[Rule], kind: str, permission: str, name: str, partitions: Sequence[str] = ()) -> Decision:
    """Decide a request by the rules of a subject: deny overrides allow, and a request that no rule allows is denied.

    Args:
        rules: the subject's rules, expanded for it; their order has no meaning.
        kind: kind of the object.
        permission: a permission of that kind.
        name: name of the object, any text.
        partitions: partitions of the endpoint; none means the default partition, whose name is empty. The
            request is allowed if it is allowed in each of them.

    Raises:
        ComArmorError: the kind or the permission is not known.
    """
    _known(kind, permission)
    names = tuple(partitions)
    parts = PARTS.get((kind, permission))
    if parts is None:
        return _decide_elementary(rules, kind, permission, name, names)
    decisions = tuple(
        _decide_elementary(rules, part_kind, part_permission, name + suffix, names)
        for part_kind, part_permission, suffix in parts
    )
    denied = next((decision for decision in decisions if not decision.allowed), None)
    if denied is not None:
        part = f"a part of it, {denied.permission} {quote(denied.object)}, is denied: "
        reason = Reason((part, *denied.reason.parts))
        return Decision(kind, permission, name, names, Effect.DENY, denied.rules, reason, decisions)
    deciding = tuple(dict.fromkeys(rule for decision in decisions for rule in decision.rules))
    return Decision(
        kind, permission, name, names, Effect.ALLOW, deciding, Reason(("all parts of it are allowed",)), decisions
    )


def _decide_elementary(
    rules: Sequence[Rule], kind: str, permission: str, name: str, partitions: tuple[str, ...]
) -> Decision:
    """Decide a request that has no parts."""
    matching = [rule for rule in rules if rule_matches(rule, kind, permission, name)]
    allowing: dict[Rule, None] = {}
    for partition in partitions or ("",):
        shown = f" in partition {quote(partition)}" if partition else ""
        denying = tuple(
            rule for rule in matching if rule.effect is Effect.DENY and rule_matches_partition(rule, partition)
        )
        if denying:
            reason = Reason(("the DENY rule", denying[0].origin, f" matches{shown}"))
            return Decision(kind, permission, name, partitions, Effect.DENY, denying, reason)
        allowing_here = tuple(
            rule for rule in matching if rule.effect is Effect.ALLOW and rule_matches_partition(rule, partition)
        )
        if not allowing_here:
            reason = Reason((f"no ALLOW rule matches{shown}",))
            return Decision(kind, permission, name, partitions, Effect.DENY, (), reason)
        allowing |= dict.fromkeys(allowing_here)
    deciding = tuple(allowing)
    reason = Reason(("the ALLOW rule", deciding[0].origin, " matches, and no DENY rule does"))
    return Decision(kind, permission, name, partitions, Effect.ALLOW, deciding, reason)


def _known(kind: str, permission: str) -> None:
    if kind not in PERMISSIONS:
        raise ComArmorError(
            f"unknown kind {quote(kind)}, expected one of {', '.join(PERMISSIONS)}",
            help=did_you_mean(kind, PERMISSIONS),
            code="unknown-kind",
        )
    if permission not in PERMISSIONS[kind]:
        raise ComArmorError(
            f"unknown permission {quote(permission)} of {kind}, expected one of {', '.join(PERMISSIONS[kind])}",
            help=did_you_mean(permission, PERMISSIONS[kind]),
            code="unknown-permission",
        )
