"""The meaning of the language, evaluated in the slow and obvious way: the oracle that compilers are tested against."""

from __future__ import annotations

from collections.abc import Sequence

from comarmor.errors import ComArmorError
from comarmor.language.syntax import Decision, Rule
from comarmor.patterns.expression import matches
from comarmor.rules import PARTS, PERMISSIONS, Effect
from comarmor.text import did_you_mean, quoted


def decide(rules: Sequence[Rule], kind: str, permission: str, name: str, partitions: Sequence[str] = ()) -> Decision:
    """Decide a request by the rules of a subject: deny overrides allow, and what nothing allows is denied.

    Args:
        rules: the subject's rules, expanded for it; their order has no meaning.
        kind: kind of the object.
        permission: a permission of that kind.
        name: name of the object, any text.
        partitions: DDS partitions of the endpoint; none means the default partition, whose name is empty. The
            endpoint is allowed when it is in each of them.

    Raises:
        ComArmorError: the kind or the permission is not known.
    """
    _known(kind, permission)
    asked = tuple(partitions)
    parts = PARTS.get((kind, permission))
    if parts is None:
        return _decide_elementary(rules, kind, permission, name, asked)
    decisions = tuple(
        _decide_elementary(rules, part_kind, part_permission, name + suffix, asked)
        for part_kind, part_permission, suffix in parts
    )
    denied = next((decision for decision in decisions if not decision.allowed), None)
    if denied is not None:
        reason = f"a part of it, {denied.permission} {quoted(denied.object)}, is denied: {denied.reason}"
        return Decision(kind, permission, name, asked, Effect.DENY, denied.rules, reason, decisions)
    deciding = tuple(dict.fromkeys(rule for decision in decisions for rule in decision.rules))
    return Decision(kind, permission, name, asked, Effect.ALLOW, deciding, "all parts of it are allowed", decisions)


def _decide_elementary(
    rules: Sequence[Rule], kind: str, permission: str, name: str, partitions: tuple[str, ...]
) -> Decision:
    """Decide a request that has no parts."""
    about = [rule for rule in rules if _covers(rule, kind, permission, name)]
    allowing: dict[Rule, None] = {}
    for partition in partitions or ("",):
        shown = f" in partition {quoted(partition)}" if partition else ""
        denying = tuple(rule for rule in about if rule.effect is Effect.DENY and _in_partition(rule, partition))
        if denying:
            reason = f"the DENY rule at {denying[0].where} matches{shown}"
            return Decision(kind, permission, name, partitions, Effect.DENY, denying, reason)
        found = tuple(rule for rule in about if rule.effect is Effect.ALLOW and _in_partition(rule, partition))
        if not found:
            return Decision(kind, permission, name, partitions, Effect.DENY, (), f"no ALLOW rule matches{shown}")
        allowing |= dict.fromkeys(found)
    deciding = tuple(allowing)
    reason = f"the ALLOW rule at {deciding[0].where} matches, and no DENY rule does"
    return Decision(kind, permission, name, partitions, Effect.ALLOW, deciding, reason)


def _covers(rule: Rule, kind: str, permission: str, name: str) -> bool:
    """Tell whether a rule is about an object, itself or as a part of what its composite kind stands for."""
    if rule.kind == kind:
        return permission in rule.permissions and any(matches(item.text, name) for item in rule.attachments)
    return any(
        (part_kind, part_permission) == (kind, permission)
        and name.endswith(suffix)
        and any(matches(item.text, name.removesuffix(suffix)) for item in rule.attachments)
        for held in rule.permissions
        for part_kind, part_permission, suffix in PARTS.get((rule.kind, held), ())
    )


def _in_partition(rule: Rule, partition: str) -> bool:
    """Tell whether a rule is about a partition: one that names none allows in the default one, and denies in all."""
    if rule.partitions:
        return any(matches(expression, partition) for expression in rule.partitions)
    return rule.effect is Effect.DENY or partition == ""


def _known(kind: str, permission: str) -> None:
    if kind not in PERMISSIONS:
        raise ComArmorError(
            f"unknown kind {quoted(kind)}, expected one of {', '.join(PERMISSIONS)}",
            help=did_you_mean(kind, PERMISSIONS),
            code="unknown-kind",
        )
    if permission not in PERMISSIONS[kind]:
        raise ComArmorError(
            f"unknown permission {quoted(permission)} of {kind}, expected one of {', '.join(PERMISSIONS[kind])}",
            help=did_you_mean(permission, PERMISSIONS[kind]),
            code="unknown-permission",
        )
