# SPDX-License-Identifier: Apache-2.0
"""Compare an existing policy with a graph: report edges that it denies, and permissions that no edge uses."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import comarmor
from comarmor.errors import Diagnostic, Origin, Spot
from comarmor.language.attachments import parts as subject_parts
from comarmor.patterns.expression import matches
from comarmor.rules import parts
from comarmor.text import quoted
from keymint.api.graph import Edge, Graph

_Need = tuple[str, str, str, tuple[str, ...]]
"""Kind, permission, name and partitions of an elementary request."""
_Unit = tuple[Spot, str]
"""Place of an attachment, and a permission. The place, because the expanded text depends on the subject."""


def conflict(edge: Edge, decision: comarmor.Decision) -> Diagnostic | None:
    """Return a warning if a DENY rule denies an edge, or None if only an ALLOW rule is missing."""
    denied = next((part for part in decision.parts or (decision,) if not part.allowed and part.rule), None)
    if denied is None or denied.where is None:
        return None
    return Diagnostic.warning(
        "learn-denied",
        f"this rule denies {edge.subject} the {edge.permission} on {quoted(edge.object.name)} that the graph has",
        denied.where.alone(),
        "narrow the rule, or leave it: a DENY wins over every ALLOW",
        edge.subject,
    )


def unused_rule_notes(policy: comarmor.Policy, graph: Graph) -> Iterator[Diagnostic]:
    """Yield notes on rules that no edge of a graph uses, and on subjects of the policy that the graph does not have."""
    units: dict[Spot, dict[_Unit, bool]] = {}
    needs: dict[str, set[_Need]] = {}
    for edge in graph.edges:
        needs.setdefault(edge.subject, set()).update(_elementary(edge))
    for subject in graph.subjects:
        for rule in (rule for profile in policy.applicable(subject) for rule in profile.rules):
            if rule.effect is comarmor.Effect.ALLOW:
                usage = units.setdefault(rule.where.spot, {})
                for unit, used in _used(rule, subject, needs.get(subject, ())):
                    usage[unit] = usage.get(unit, False) or used
    for place, usage in sorted(units.items()):
        yield from _unused_units(place, usage)
    for subject in policy.subjects():
        if subject not in graph.subjects:
            message = f"the policy names {subject}, which the graph does not have"
            yield Diagnostic.note("learn-unused-subject", message, subject=subject)


def _elementary(edge: Edge) -> Iterator[_Need]:
    for kind, permission, suffix in parts(edge.object.kind, edge.permission):
        yield kind, permission, edge.object.name + suffix, edge.object.partitions or ("",)


def _used(rule: comarmor.ProfileRule, subject: str, needs: Iterable[_Need]) -> Iterator[tuple[_Unit, bool]]:
    """Yield each attachment and permission of a rule, and whether the subject needs it."""
    for permission in rule.permissions:
        candidates = [
            (name.removesuffix(suffix), partitions)
            for kind, needed, name, partitions in needs
            for part_kind, part_permission, suffix in parts(rule.kind, permission)
            if (part_kind, part_permission) == (kind, needed) and name.endswith(suffix)
        ]
        for attachment in rule.attachments:
            expression = attachment.for_parts(*subject_parts(subject))
            used = any(
                matches(expression, name) and any(_in_partition(rule, partition) for partition in partitions)
                for name, partitions in candidates
            )
            yield (attachment.where.spot, permission), used


def _in_partition(rule: comarmor.ProfileRule, partition: str) -> bool:
    if rule.partitions:
        return any(matches(expression, partition) for expression in rule.partitions)
    return partition == ""


def _unused_units(place: Spot, usage: dict[_Unit, bool]) -> Iterator[Diagnostic]:
    """Yield notes on one rule that is not used, or on attachments and permissions of it that are not used."""
    if not any(usage.values()):
        permissions = ", ".join(dict.fromkeys(permission for _, permission in usage))
        yield _note("learn-unused-rule", place, f"no subject in the graph uses this rule ({permissions})")
        return
    for attachment in dict.fromkeys(unit[0] for unit in usage):
        if not any(used for unit, used in usage.items() if unit[0] == attachment):
            yield _note("learn-unused-attachment", attachment, "no subject in the graph uses this attachment")
    for permission in dict.fromkeys(unit[1] for unit in usage):
        if not any(used for unit, used in usage.items() if unit[1] == permission):
            yield _note("learn-unused-permission", place, f"no subject in the graph uses {permission} of this rule")


def _note(code: str, place: Spot, message: str) -> Diagnostic:
    file, line, column = place
    where = Origin(file, line, (), column)
    return Diagnostic.note(code, message, where, "remove it unless it is for a rare case")
