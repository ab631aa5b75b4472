"""Holds an existing policy against a graph: what it denies on purpose, and what it allows that nobody needs."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import comarmor
from comarmor.errors import Diagnostic, Origin, Severity, Spot
from comarmor.patterns.expression import matches
from comarmor.text import quoted
from keymint.graph import Edge, Graph

_Need = tuple[str, str, str, tuple[str, ...]]
_Place = Spot
_Unit = tuple[_Place, str]
"""Place of an attachment, and a permission. The place, for its text may differ from subject to subject."""


def conflict(edge: Edge, decision: comarmor.Decision) -> Diagnostic | None:
    """Return what is to be said of an edge that a DENY rule denies, or None when nothing but an ALLOW is missing."""
    denied = next((one for one in decision.parts or (decision,) if not one.allowed and one.rule), None)
    if denied is None or denied.where is None:
        return None
    return Diagnostic(
        "learn-denied",
        Severity.WARNING,
        f"this rule denies {edge.subject} the {edge.permission} on {quoted(edge.object.name)} that the graph has",
        Origin(denied.where.file, denied.where.line, (), denied.where.column),
        "narrow the rule, or leave it: a DENY wins over every ALLOW",
        edge.subject,
    )


def unused(policy: comarmor.Policy, graph: Graph) -> Iterator[Diagnostic]:
    """Yield what a policy allows to the subjects of a graph that no edge needs, and whom it names in vain."""
    units: dict[_Place, dict[_Unit, bool]] = {}
    needs: dict[str, set[_Need]] = {}
    for edge in graph.edges:
        needs.setdefault(edge.subject, set()).update(_elementary(edge))
    for subject in graph.subjects:
        for rule in policy.rules(subject):
            if rule.effect is comarmor.Effect.ALLOW:
                known = units.setdefault(_place(rule.where), {})
                for unit, used in _used(rule, needs.get(subject, ())):
                    known[unit] = known.get(unit, False) or used
    for place, found in sorted(units.items()):
        yield from _said(place, found)
    for subject in policy.subjects():
        if subject not in graph.subjects:
            message = f"the policy names {subject}, which the graph does not have"
            yield Diagnostic("learn-unused-subject", Severity.NOTE, message, subject=subject)


def _elementary(edge: Edge) -> Iterator[_Need]:
    found = edge.object
    for kind, permission, suffix in comarmor.PARTS.get(
        (found.kind, edge.permission), ((found.kind, edge.permission, ""),)
    ):
        yield kind, permission, found.name + suffix, found.partitions or ("",)


def _used(rule: comarmor.Rule, needs: Iterable[_Need]) -> Iterator[tuple[_Unit, bool]]:
    for permission in rule.permissions:
        parts = comarmor.PARTS.get((rule.kind, permission), ((rule.kind, permission, ""),))
        about = [
            (name.removesuffix(suffix), partitions)
            for kind, needed, name, partitions in needs
            for part_kind, part_permission, suffix in parts
            if (part_kind, part_permission) == (kind, needed) and name.endswith(suffix)
        ]
        for attachment in rule.attachments:
            used = any(
                matches(attachment.text, name) and any(_in_partition(rule, one) for one in partitions)
                for name, partitions in about
            )
            yield (_place(attachment.where), permission), used


def _in_partition(rule: comarmor.Rule, partition: str) -> bool:
    if rule.partitions:
        return any(matches(expression, partition) for expression in rule.partitions)
    return partition == ""


def _said(place: _Place, found: dict[_Unit, bool]) -> Iterator[Diagnostic]:
    """Yield what is to be said of one rule: that it, an attachment of it, or a permission is not used."""
    if not any(found.values()):
        permissions = ", ".join(dict.fromkeys(permission for _, permission in found))
        yield _note("learn-unused-rule", place, f"nobody in the graph uses this rule ({permissions})")
        return
    for attachment in dict.fromkeys(unit[0] for unit in found):
        if not any(used for unit, used in found.items() if unit[0] == attachment):
            yield _note("learn-unused-attachment", attachment, "nobody in the graph uses this attachment")
    for permission in dict.fromkeys(unit[1] for unit in found):
        if not any(used for unit, used in found.items() if unit[1] == permission):
            yield _note("learn-unused-permission", place, f"nobody in the graph uses the {permission} of this rule")


def _note(code: str, place: _Place, message: str) -> Diagnostic:
    file, line, column = place
    where = Origin(file, line, (), column)
    return Diagnostic(code, Severity.NOTE, message, where, "remove it if it is not for something rare")


def _place(where: comarmor.Origin) -> _Place:
    return where.file, where.line, where.column
